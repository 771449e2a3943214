//! What of the configuration concerns CAN.

use crate::config::{CanOut, Config, Wheels};
use crate::runtime::rights::RealTimeConfig;
use crate::wheels::{MappingError, WheelDecoder};

/// What [`super::open`] needs.
#[derive(Clone, Debug)]
pub struct CanPlan {
    /// Wheel readings, where they come by CAN.
    pub wheels: Option<CanWheelsPlan>,
    /// What is sent; its interface is given.
    pub out: Option<CanOut>,
    /// Whether CAN FD frames are received and sent.
    pub fd: bool,
    /// What the thread asks of the kernel.
    pub real_time: RealTimeConfig,
}

/// Wheel readings by CAN.
#[derive(Clone, Debug)]
pub struct CanWheelsPlan {
    /// Interface.
    pub interface: String,
    /// Decodes the wheel message.
    pub decoder: WheelDecoder,
    /// Added to every stamp.
    pub offset_micros: i64,
}

impl CanPlan {
    /// The plan of a configuration; none where it names no interface.
    ///
    /// # Errors
    /// The DBC file of the wheels does not fit.
    pub fn of(config: &Config) -> Result<Option<Self>, MappingError> {
        let wheels = match config.wheels() {
            Wheels::Can(wheels) => match &wheels.interface {
                Some(interface) => Some(CanWheelsPlan {
                    interface: interface.clone(),
                    decoder: WheelDecoder::open(&wheels.dbc, &wheels.mapping())?,
                    offset_micros: wheels.offset_micros(),
                }),
                None => None,
            },
            Wheels::None | Wheels::Sim(_) => None,
        };
        let out = config.can_out().filter(|out| out.interface.is_some());
        if wheels.is_none() && out.is_none() {
            return Ok(None);
        }
        Ok(Some(Self {
            wheels,
            out,
            fd: config.can.fd,
            real_time: config.real_time(),
        }))
    }

    /// The interfaces, each once.
    #[must_use]
    pub fn interfaces(&self) -> Vec<String> {
        let wheels = self.wheels.as_ref().map(|wheels| wheels.interface.clone());
        let out = self.out.as_ref().and_then(|out| out.interface.clone());
        let mut interfaces: Vec<String> = wheels.into_iter().chain(out).collect();
        interfaces.dedup();
        interfaces
    }
}
