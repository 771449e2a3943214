//! Error frames of a CAN controller, decoded: what became of the bus.
//!
//! In: the identifier and eight bytes of an error frame. Out: a [`Report`]. Cost: a few bit tests.
//! Source: linux/can/error.h.

const TX_TIMEOUT: u32 = 0x001;
const CONTROLLER: u32 = 0x004;
const PROTOCOL: u32 = 0x008;
const NO_ACKNOWLEDGE: u32 = 0x020;
const BUS_OFF: u32 = 0x040;
const BUS_ERROR: u32 = 0x080;
const RESTARTED: u32 = 0x100;

/// Classes that are asked for; lost arbitration is no fault, and may come with every frame.
pub(super) const WANTED: u32 =
    TX_TIMEOUT | CONTROLLER | PROTOCOL | NO_ACKNOWLEDGE | BUS_OFF | BUS_ERROR | RESTARTED;

/// State of a controller by its error counters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ControllerState {
    /// All is well.
    Active,
    /// An error counter is above 96.
    Warning,
    /// An error counter is above 127: it may not signal errors any more.
    Passive,
}

/// What one error frame says.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Report {
    pub(super) is_bus_off: bool,
    pub(super) is_restarted: bool,
    pub(super) is_unacknowledged: bool,
    pub(super) is_bus_error: bool,
    pub(super) is_overflow: bool,
    pub(super) is_transmit_timeout: bool,
    pub(super) state: Option<ControllerState>,
}

impl Report {
    pub(super) fn of(id: u32, data: &[u8]) -> Self {
        let problem = data.get(1).copied().unwrap_or(0);
        let state = if id & CONTROLLER == 0 {
            None
        } else if problem & 0x30 != 0 {
            Some(ControllerState::Passive)
        } else if problem & 0x0C != 0 {
            Some(ControllerState::Warning)
        } else if problem & 0x40 != 0 {
            Some(ControllerState::Active)
        } else {
            None
        };
        Self {
            is_bus_off: id & BUS_OFF != 0,
            is_restarted: id & RESTARTED != 0,
            is_unacknowledged: id & NO_ACKNOWLEDGE != 0,
            is_bus_error: id & (PROTOCOL | BUS_ERROR) != 0,
            is_overflow: id & CONTROLLER != 0 && problem & 0x03 != 0,
            is_transmit_timeout: id & TX_TIMEOUT != 0,
            state,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn causes_are_told_apart() {
        let of = |id, problem| Report::of(id, &[0, problem, 0, 0, 0, 0, 0, 0]);
        assert!(of(0x040, 0).is_bus_off && !of(0x100, 0).is_bus_off);
        assert!(of(0x100, 0).is_restarted);
        assert!(of(0x020, 0).is_unacknowledged);
        assert!(of(0x088, 0).is_bus_error);
        assert_eq!(of(0x004, 0x20).state, Some(ControllerState::Passive));
        assert_eq!(of(0x004, 0x08).state, Some(ControllerState::Warning));
        assert_eq!(of(0x004, 0x40).state, Some(ControllerState::Active));
        assert_eq!(of(0x008, 0x20).state, None);
        assert!(of(0x204, 0x01).is_overflow);
        assert_eq!(Report::of(0x002, &[]), Report::default());
    }
}
