//! Format, size and rate: asked for in the order of preference, the driver's answer checked.
//!
//! In: the request. Out: the first format that comes at the size and rate asked for, its rows and bytes understood; else what
//! each format came to, and what the device offers. Cost: a few system calls a format, at start and when a camera comes back.

use std::fmt::Write as _;

use rustix::io::Errno;

use super::error::{OpenError, Trouble};
use super::node::{FourCc, Interval, Layout, Node};
use super::pixels::Rows;
use super::request::Request;
use crate::config::DeviceFormat;

/// A rate this near is the one asked for: 29.97 Hz is 30.
const RATE_TOLERANCE: f64 = 0.05;

/// Sizes listed of a format of a device that does not fit; the rest is `v4l2-ctl`'s.
const LISTED: u32 = 8;

/// Formats looked through at most.
const MOST_FORMATS: u32 = 256;

/// Formats that the core reads, or that are decoded for it.
const READ: [DeviceFormat; 5] = [
    DeviceFormat::Yuyv,
    DeviceFormat::Nv12,
    DeviceFormat::Rgb24,
    DeviceFormat::Grey,
    DeviceFormat::Mjpeg,
];

/// What was agreed with a driver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Agreement {
    pub(super) format: DeviceFormat,
    pub(super) rows: Rows,
    /// None where the driver does not say.
    pub(super) rate_millihertz: Option<u32>,
}

/// The kernel's name of a format.
pub(super) const fn four_cc(format: DeviceFormat) -> FourCc {
    FourCc(*match format {
        DeviceFormat::Yuyv => b"YUYV",
        DeviceFormat::Nv12 => b"NV12",
        DeviceFormat::Grey => b"GREY",
        DeviceFormat::Rgb24 => b"RGB3",
        DeviceFormat::Mjpeg => b"MJPG",
    })
}

/// Sets the device up.
pub(super) fn negotiate(node: &mut impl Node, request: &Request) -> Result<Agreement, Trouble> {
    let mut answers = String::new();
    for &format in &request.formats {
        match try_format(node, request, format)? {
            Ok(agreement) => return Ok(agreement),
            Err(answer) => {
                let separator = if answers.is_empty() { "" } else { ", " };
                // A `String` takes all that is written to it.
                let _ = write!(answers, "{separator}{} {answer}", four_cc(format));
            }
        }
    }
    Err(Trouble::Wrong(OpenError::NoFormat {
        device: request.device.clone(),
        asked: format!("{}x{} at {} Hz", request.width, request.height, request.rate_hz),
        answers,
        offers: offers(node),
    }))
}

/// Asks for one format: agreed, or what came instead.
fn try_format(
    node: &mut impl Node,
    request: &Request,
    format: DeviceFormat,
) -> Result<Result<Agreement, String>, Trouble> {
    let wanted = Layout {
        format: four_cc(format),
        width: request.width,
        height: request.height,
        bytes_per_line: 0,
        image_bytes: 0,
        is_progressive: true,
    };
    let given = match node.set_layout(wanted) {
        Err(Errno::INVAL) => return Ok(Err("is refused".to_owned())),
        other => other?,
    };
    if given.format != wanted.format {
        return Ok(Err(format!("becomes {}", given.format)));
    }
    if (given.width, given.height) != (wanted.width, wanted.height) {
        return Ok(Err(format!("comes as {}x{}", given.width, given.height)));
    }
    if !given.is_progressive {
        return Ok(Err("comes interlaced".to_owned()));
    }
    let Some(rows) = Rows::of(format, &given) else {
        return Ok(Err(format!(
            "comes in rows of {} and frames of {} bytes, too few",
            given.bytes_per_line, given.image_bytes
        )));
    };
    let rate_hz = match node.set_interval(interval(request.rate_hz)) {
        Err(Errno::INVAL) => None,
        other => other?.map(|given| f64::from(given.denominator) / f64::from(given.numerator)),
    };
    if let Some(hz) = rate_hz
        && (hz / request.rate_hz - 1.0).abs() > RATE_TOLERANCE
    {
        return Ok(Err(format!("comes at {hz:.2} Hz")));
    }
    Ok(Ok(Agreement {
        format,
        rows,
        rate_millihertz: rate_hz.map(millihertz),
    }))
}

fn interval(rate_hz: f64) -> Interval {
    Interval {
        numerator: 1_000,
        denominator: millihertz(rate_hz),
    }
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "near a rate of at most 240 Hz, checked in the config"
)]
fn millihertz(rate_hz: f64) -> u32 {
    (rate_hz * 1_000.0).round() as u32
}

/// What the device has, for the message; as much as it tells.
fn offers(node: &mut impl Node) -> String {
    let mut list = String::new();
    let mut others = 0;
    for number in 0..MOST_FORMATS {
        let Ok(format) = node.format_at(number) else {
            break;
        };
        if !READ.map(four_cc).contains(&format) {
            others += 1;
            continue;
        }
        let separator = if list.is_empty() { "" } else { ", " };
        let _ = write!(list, "{separator}{format}");
        for number in 0..LISTED {
            let Ok(size) = node.size_at(format, number) else {
                break;
            };
            let _ = write!(list, " {size}");
        }
    }
    if list.is_empty() {
        list.push_str("none of the formats that are read");
    }
    if others > 0 {
        let _ = write!(list, " ({others} other formats are not read)");
    }
    list
}
