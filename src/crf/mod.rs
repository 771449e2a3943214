//! Stage 6, crf: the energy of the paper and its minimum cut, stoppable at any time.
//!
//! In: [`CrfInputs`], all `[height, width]` at the CRF resolution. Out: labels `[height, width] u8` (1 = road), P(road)
//! `[height, width] f32`, and a bound on how far the labelling is from the minimum.
//!
//! [`CrfStage::base`] leaves a valid labelling; [`CrfStage::refine`] lowers its energy, one bounded quantum a call.

mod cut;
mod energy;
mod islands;
mod stage;

pub use cut::{CutState, GridCut, GridProblem, Halved, halve};
pub use energy::{Ablation, Capacities, CrfConfig, CrfInputs, Energy, TermForm, UNIT};
pub use islands::Islands;
pub use stage::CrfStage;
