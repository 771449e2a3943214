//! Where the road ahead is free, in metres and on time, from one camera and the wheel encoders.
//!
//! This is the core: `no_std + alloc`, without clock, thread, file or socket. Memory is allocated in constructors only;
//! a step of [`pipeline`] allocates nothing. Devices, threads and the program live in `freespace-platform`.
//!
//! A frame passes the stages in the order of the modules: [`frame`], [`track`], [`map`], [`priors`], [`segmentation`],
//! [`crf`], [`grid`], [`emit`]. "The paper" is *A Joint 3D-2D based Method for Free Space Detection on Roads* (WACV 2018).
#![no_std]
#![forbid(unsafe_code)]

extern crate alloc;

pub mod budget;
pub mod deadline;
pub mod health;
pub mod pipeline;
pub mod port;
pub mod space;
pub mod stage;

pub mod crf;
pub mod emit;
pub mod frame;
pub mod grid;
pub mod map;
pub mod priors;
pub mod segmentation;
pub mod track;
