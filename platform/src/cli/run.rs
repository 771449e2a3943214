//! `freespace run`: the camera and the bus of this computer, until it is told to end.

use std::collections::BTreeMap;

use freespace::pipeline::Cadence;

use super::drive::{self, Progress, Recorder, Watch};
use super::{Failure, Pace, RunArgs, table};
use crate::bad_input::BadInput;
use crate::camera::v4l2::V4l2Camera;
use crate::can;
use crate::clock::MonotonicClock;
use crate::config::{Config, Wheels};
use crate::runtime::{Devices, Setup};
use crate::sink::recording::{Recording, Report, RunTitle};

