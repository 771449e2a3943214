//! What is done to the camera and the bus while the module drives.
//!
//! A feeder looks at its switch before every picture and every wheel frame: a fault begins with the next one.

use std::sync::atomic::{AtomicU8, Ordering};

/// What happens to the pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum CameraFault {
    None,
    /// Every second picture is not sent.
    Drops,
    /// Every second picture is sent twice, in place of its successor.
    Duplicates,
    /// One picture again and again.
    Freezes,
    /// Black pictures.
    Black,
    /// No picture, the device stays.
    Silent,
    /// The device ends, as a camera that is pulled out.
    Unplugged,
    /// The device comes back with pictures of another size.
    WrongSize,
}

/// What happens to the wheel frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum WheelFault {
    None,
    /// No wheel frame.
    Silent,
    /// Random bytes under the wheel message's identifier.
    Garbage,
    /// The alive counter stands still.
    WrongCounter,
    /// The checksum is that of other bytes.
    WrongChecksum,
    /// The counter of one wheel stands still.
    StuckWheel,
}

const CAMERA: [CameraFault; 8] = [
    CameraFault::None,
    CameraFault::Drops,
    CameraFault::Duplicates,
    CameraFault::Freezes,
    CameraFault::Black,
    CameraFault::Silent,
    CameraFault::Unplugged,
    CameraFault::WrongSize,
];

const WHEELS: [WheelFault; 6] = [
    WheelFault::None,
    WheelFault::Silent,
    WheelFault::Garbage,
    WheelFault::WrongCounter,
    WheelFault::WrongChecksum,
    WheelFault::StuckWheel,
];

/// The switches of one drive.
#[derive(Debug, Default)]
pub(crate) struct Switches {
    camera: AtomicU8,
    wheels: AtomicU8,
}

impl Switches {
    pub(crate) fn camera(&self) -> CameraFault {
        CAMERA[usize::from(self.camera.load(Ordering::Relaxed)) % CAMERA.len()]
    }

    pub(crate) fn wheels(&self) -> WheelFault {
        WHEELS[usize::from(self.wheels.load(Ordering::Relaxed)) % WHEELS.len()]
    }

    pub(crate) fn set_camera(&self, fault: CameraFault) {
        self.camera.store(fault as u8, Ordering::Relaxed);
    }

    pub(crate) fn set_wheels(&self, fault: WheelFault) {
        self.wheels.store(fault as u8, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::{CAMERA, Switches, WHEELS};

    #[test]
    fn a_switch_reads_as_it_was_set() {
        let switches = Switches::default();
        for fault in CAMERA {
            switches.set_camera(fault);
            assert_eq!(switches.camera(), fault);
        }
        for fault in WHEELS {
            switches.set_wheels(fault);
            assert_eq!(switches.wheels(), fault);
        }
    }
}
