//! `[can]`: the interface that the module sends to, and what it sends there.

use freespace::emit::can::FRAMES;
use freespace::emit::{BitRates, BusLoad, grid_frames};
use serde::Deserialize;

use super::{Config, Invalid, within};

/// Longest name of a network interface; IFNAMSIZ of linux/if.h less its end.
const MOST_NAME_BYTES: usize = 15;

/// What the config says of CAN frames sent.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CanSection {
    /// Interface that the module sends to; it sends nothing without.
    pub interface: Option<String>,
    /// Whether the interface is opened for CAN FD.
    pub fd: bool,
    /// Whether the whole grid is sent, in CAN FD frames.
    pub grid: bool,
    /// Bit rate of classic frames and of the arbitration, bits a second.
    pub bit_rate: Option<f64>,
    /// Bit rate of the data of CAN FD frames, bits a second.
    pub data_bit_rate: Option<f64>,
    /// Largest share of the bus's time that a publication takes while it leaves.
    pub share: Option<f64>,
}

/// The checked plan of what is sent.
#[derive(Clone, Debug, PartialEq)]
pub struct CanOut {
    /// Interface that the module sends to; none where it sends nothing.
    pub interface: Option<String>,
    /// Whether the interface is opened for CAN FD.
    pub fd: bool,
    /// Frames of the grid, its head included; 0 where it is not sent.
    pub grid_frames: usize,
    /// Bit rates of the bus.
    pub rates: BitRates,
    /// Largest share of the bus's time that a publication takes while it leaves.
    pub share: f64,
    /// Time between publications.
    pub period_micros: u64,
}

impl CanOut {
    /// What the publications cost the bus.
    #[must_use]
    pub fn load(&self) -> BusLoad {
        #[expect(clippy::cast_precision_loss, reason = "seconds")]
        let hertz = 1e6 / self.period_micros.max(1) as f64;
        BusLoad::of_publications(hertz, self.rates, self.grid_frames)
    }
}

/// A line for the start of a run.
impl std::fmt::Display for CanOut {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let load = self.load();
        write!(formatter, "{FRAMES} frames of 8 bytes")?;
        if self.grid_frames > 0 {
            write!(formatter, " and {} of 64", self.grid_frames)?;
        }
        write!(
            formatter,
            " every {} ms: {:.0} bit/s, {:.2} % of a bus of {} kbit/s",
            self.period_micros / 1000,
            load.bits_per_second,
            100.0 * load.share,
            self.rates.nominal / 1000
        )?;
        if self.fd {
            write!(formatter, " (data of CAN FD {} kbit/s)", self.rates.data / 1000)?;
        }
        Ok(())
    }
}

/// 500 kbit/s, the rate of most cars' buses.
const BIT_RATE: f64 = 500_000.0;
/// 2 Mbit/s, the rate of most CAN FD buses.
const DATA_BIT_RATE: f64 = 2_000_000.0;
/// Half of the bus is left to others while a publication leaves.
const SHARE: f64 = 0.5;

/// A name that the kernel may give an interface.
pub(super) fn interface_name(key: &'static str, name: &str) -> Result<String, Invalid> {
    let is_name = (1..=MOST_NAME_BYTES).contains(&name.len())
        && !matches!(name, "." | "..")
        && (name.bytes()).all(|byte| byte.is_ascii_graphic() && !matches!(byte, b'/' | b':'));
    if is_name {
        return Ok(name.to_owned());
    }
    Err(Invalid::new(
        key,
        format!("`{key}` is \"{name}\", no name of an interface"),
        "set it to one that `ip link show type can` lists, such as \"can0\"",
    ))
}

impl CanSection {
    fn plan(&self, period_s: f64, cells: usize) -> Result<CanOut, Invalid> {
        let interface = (self.interface.as_deref())
            .map(|name| interface_name("can.interface", name))
            .transpose()?;
        let bit_rate = self.bit_rate.unwrap_or(BIT_RATE);
        within("can.bit_rate", bit_rate, 1e4..=1e6, "bit/s")?;
        let data_bit_rate = self.data_bit_rate.unwrap_or(DATA_BIT_RATE.max(bit_rate));
        within("can.data_bit_rate", data_bit_rate, bit_rate..=1e7, "bit/s")?;
        let share = self.share.unwrap_or(SHARE);
        within("can.share", share, 0.01..=1.0, "of the bus")?;
        if self.grid && !self.fd {
            return Err(Invalid::new(
                "can.grid",
                "`can.grid` is set, but the grid goes in CAN FD frames and `can.fd` is not",
                "set `fd = true` in [can], or remove `grid`",
            ));
        }
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "checked: at most 10^7 bits a second, and 10 s"
        )]
        let plan = CanOut {
            interface,
            fd: self.fd,
            grid_frames: if self.grid {
                grid_frames::frames_of(cells)
            } else {
                0
            },
            rates: BitRates {
                nominal: bit_rate as u32,
                data: data_bit_rate as u32,
            },
            share,
            period_micros: (period_s * 1e6).round() as u64,
        };
        let load = plan.load();
        if load.share > share {
            return Err(Invalid::new(
                if self.grid { "can.grid" } else { "can.bit_rate" },
                format!(
                    "the publications take {:.0} % of the bus, more than `can.share` allows ({:.0} %)",
                    100.0 * load.share,
                    100.0 * share
                ),
                "raise `share` or the bit rates in [can], make the cells of [grid] larger, or leave the grid out",
            ));
        }
        Ok(plan)
    }
}

impl Config {
    /// What is sent on CAN, checked when the config was read.
    #[must_use]
    pub fn can_out(&self) -> Option<CanOut> {
        self.plan_can().ok()
    }

    pub(super) fn plan_can(&self) -> Result<CanOut, Invalid> {
        let (rows, columns, _) = self.grid.size();
        self.can.plan(self.key_frames.interval_s, rows * columns)
    }
}
