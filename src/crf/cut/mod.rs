//! Minimum cut of a 4-connected grid, exact when left to finish and stoppable at any time.
//!
//! In: a [`GridProblem`], capacities `[height, width] i32`. Out: labels `[height, width] u8` (1 = source side) and bounds
//! on the minimum energy, in the capacities' unit.
//!
//! Invariant: the residual graph always describes the same energy up to the constant `lower`, so any labelling can be
//! priced from it, and `lower <= minimum <= upper` holds after every call. The best labelling priced so far is kept.
//!
//! Cost: one step is one node scanned, adopted or passed by an augmenting path; [`GridCut::advance`] overshoots its cap
//! by at most one path. All storage is sized by [`GridCut::new`]; queues hold a node at most once and cannot overflow.
//!
//! Source: incremental breadth-first search (Goldberg, Hed, Kaplan, Tarjan, Werneck, ESA 2011) on an implicit grid:
//! two breadth-first trees from both terminals, augmented along shortest paths, repaired by distance labels. Terminal
//! capacities are one signed number a node, so any flow within the arc capacities is a valid start (as in Kohli and
//! Torr, "Dynamic graph cuts", 2007): [`GridCut::start_from_half`] begins with the flow of a cut at half resolution.
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_possible_wrap,
    reason = "node indices and grid coordinates are bounded by the image, which is far below 2^31 pixels"
)]

mod half;
mod queue;
mod repair;
mod start;
mod trees;

#[cfg(test)]
mod tests;

use alloc::boxed::Box;
use alloc::vec;

pub use half::{Halved, halve};
use queue::{OrphanBuckets, Ring};

/// The energy to minimise: `sum_p (label 1 ? sink : source) + sum_pq (labels differ ? right or down : 0)`.
///
/// All slices are `[height, width] i32`, row-major, not negative; `right` of the last column and `down` of the last row are ignored.
#[derive(Clone, Copy, Debug)]
pub struct GridProblem<'a> {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// Cost of label 0 (sink side), the capacity from the source.
    pub source: &'a [i32],
    /// Cost of label 1 (source side), the capacity to the sink.
    pub sink: &'a [i32],
    /// Cost of unlike labels at `(x, y)` and `(x + 1, y)`.
    pub right: &'a [i32],
    /// Cost of unlike labels at `(x, y)` and `(x, y + 1)`.
    pub down: &'a [i32],
}

impl GridProblem<'_> {
    /// Energy of a labelling.
    #[must_use]
    pub fn energy(&self, labels: &[u8]) -> i64 {
        let mut energy = 0_i64;
        for y in 0..self.height {
            for x in 0..self.width {
                let p = y * self.width + x;
                energy += i64::from(if labels[p] != 0 {
                    self.sink[p]
                } else {
                    self.source[p]
                });
                if x + 1 < self.width && labels[p] != labels[p + 1] {
                    energy += i64::from(self.right[p]);
                }
                if y + 1 < self.height && labels[p] != labels[p + self.width] {
                    energy += i64::from(self.down[p]);
                }
            }
        }
        energy
    }
}

/// Whether a cut is finished.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CutState {
    /// More steps may improve the labelling or the bounds.
    Running,
    /// The labelling is a minimum.
    Done,
}

/// Tree membership of a node.
const FREE: u8 = 0;
const SOURCE: u8 = 1;
const SINK: u8 = 2;
/// `Node::parent` of a root, and of a node that has lost its parent; smaller values are directions.
const TERMINAL: u8 = 4;
const ORPHAN: u8 = 5;
/// `Node::parent` of an orphan that found none at its own distance.
const UNLINKED: u8 = 6;

/// All that a visit to a pixel needs, half a cache line.
#[derive(Clone, Copy, Debug)]
#[repr(align(32))]
struct Node {
    /// Residual capacity to the right, left, lower and upper neighbour; direction `k ^ 1` is the opposite of `k`.
    residual: [i32; 4],
    /// Residual capacity from the source where positive, to the sink where negative.
    excess: i32,
    /// Distance to the terminal of its tree, 1 for a root.
    label: u32,
    /// Next in the same bucket of orphans.
    next_orphan: u32,
    tree: u8,
    parent: u8,
    /// Bit `tree` is set while the node waits in a queue of that tree.
    queued: u8,
}

const EMPTY_NODE: Node = Node {
    residual: [0; 4],
    excess: 0,
    label: 0,
    next_orphan: 0,
    tree: FREE,
    parent: ORPHAN,
    queued: 0,
};

/// One search tree: its depth and its nodes yet to be scanned.
#[derive(Clone, Debug)]
struct Tree {
    /// Every node below this label has been scanned.
    depth: u32,
    /// Nodes at `depth`.
    current: Ring,
    /// Nodes at `depth + 1`.
    next: Ring,
    orphans: OrphanBuckets,
    repair: Repair,
    /// Nodes that lost their place in this repair.
    unlinked: Ring,
    /// Nodes that found a new one, whose neighbours may follow.
    linked: Ring,
}

/// Where the repair of a tree stands, with the index in `unlinked` it has reached.
#[derive(Clone, Copy, Debug)]
enum Repair {
    Detach,
    Measure(usize),
    Attach,
    Release(usize),
}

/// A minimum cut under way. See the module for its invariant.
#[derive(Clone, Debug)]
pub struct GridCut {
    width: usize,
    height: usize,
    /// Nodes a row, one of them padding that stands for both the left and the right border.
    stride: usize,
    nodes: Box<[Node]>,
    trees: [Tree; 2],
    /// The tree that grows: an index into `trees`.
    growing: usize,
    /// The node being scanned.
    scanned: Option<u32>,
    lower: i64,
    best_lower: i64,
    upper: i64,
    best: Box<[u8]>,
    state: CutState,
    steps_since_priced: u32,
}

impl GridCut {
    /// A solver for grids of `width x height` pixels.
    #[must_use]
    pub fn new(width: usize, height: usize) -> Self {
        let stride = width + 1;
        let count = stride * (height + 2) + 1;
        let tree = || Tree {
            depth: 1,
            current: Ring::new(width * height),
            next: Ring::new(width * height),
            orphans: OrphanBuckets::new(width * height + 3),
            repair: Repair::Detach,
            unlinked: Ring::new(width * height),
            linked: Ring::new(width * height),
        };
        Self {
            width,
            height,
            stride,
            nodes: vec![EMPTY_NODE; count].into_boxed_slice(),
            trees: [tree(), tree()],
            growing: 0,
            scanned: None,
            lower: 0,
            best_lower: 0,
            upper: 0,
            best: vec![0; width * height].into_boxed_slice(),
            state: CutState::Done,
            steps_since_priced: 0,
        }
    }

    /// Width in pixels.
    #[must_use]
    pub const fn width(&self) -> usize {
        self.width
    }

    /// Height in pixels.
    #[must_use]
    pub const fn height(&self) -> usize {
        self.height
    }

    /// Works on for about `max_steps` steps.
    pub fn advance(&mut self, max_steps: u32) -> CutState {
        if self.state == CutState::Running {
            let steps = self.grow(max_steps);
            self.steps_since_priced = self.steps_since_priced.saturating_add(steps);
            self.best_lower = self.best_lower.max(self.lower);
            // Pricing costs about a quarter of as many steps: often enough to stop on, seldom enough not to matter.
            if self.state == CutState::Done || self.steps_since_priced as usize >= self.best.len() / 2 {
                self.price();
            }
        }
        self.state
    }

    /// Whether the cut is finished.
    #[must_use]
    pub const fn state(&self) -> CutState {
        self.state
    }

    /// The best labelling so far, `[height, width] u8`, 1 on the source side.
    #[must_use]
    pub fn labels(&self) -> &[u8] {
        &self.best
    }

    /// Copies the best labelling so far.
    pub fn labels_into(&self, labels: &mut [u8]) {
        labels.copy_from_slice(&self.best);
    }

    /// Bounds on the minimum energy: the flow so far, and the energy of the labelling.
    #[must_use]
    pub const fn bounds(&self) -> (i64, i64) {
        (self.best_lower, self.upper)
    }

    /// Takes `labels` as the labelling where its energy is lower than that of the best so far.
    pub fn offer(&mut self, labels: &[u8]) {
        let energy = self.energy_of(|_, p| labels[p] != 0);
        if energy < self.upper {
            self.upper = energy;
            self.best.copy_from_slice(labels);
        }
    }

    /// Prices the labellings that the trees suggest and keeps the best.
    fn price(&mut self) {
        self.steps_since_priced = 0;
        let narrow = self.energy_of(|node, _| node.tree == SOURCE);
        let wide = self.energy_of(|node, _| node.tree != SINK);
        if narrow.min(wide) >= self.upper {
            return;
        }
        self.upper = narrow.min(wide);
        for y in 0..self.height {
            let row = self.index(0, y);
            for x in 0..self.width {
                let tree = self.nodes[row + x].tree;
                let is_source_side = if narrow <= wide {
                    tree == SOURCE
                } else {
                    tree != SINK
                };
                self.best[y * self.width + x] = u8::from(is_source_side);
            }
        }
    }

    /// Energy of a labelling, from the residual graph: `lower` plus the residual capacities that it cuts.
    fn energy_of(&self, is_source_side: impl Fn(&Node, usize) -> bool) -> i64 {
        let mut energy = self.lower;
        for y in 0..self.height {
            let row = self.index(0, y);
            for x in 0..self.width {
                let (p, i) = (y * self.width + x, row + x);
                let node = &self.nodes[i];
                let side = is_source_side(node, p);
                energy += i64::from(if side {
                    -node.excess.min(0)
                } else {
                    node.excess.max(0)
                });
                if x + 1 < self.width {
                    let right = &self.nodes[i + 1];
                    let other = is_source_side(right, p + 1);
                    energy += i64::from(cut_arc(side, other, node.residual[0], right.residual[1]));
                }
                if y + 1 < self.height {
                    let below = &self.nodes[i + self.stride];
                    let other = is_source_side(below, p + self.width);
                    energy += i64::from(cut_arc(side, other, node.residual[2], below.residual[3]));
                }
            }
        }
        energy
    }

    const fn index(&self, x: usize, y: usize) -> usize {
        (y + 1) * self.stride + x + 1
    }
}

/// What a pair of labels cuts: the arc that leaves the source side.
const fn cut_arc(side: bool, other: bool, forward: i32, backward: i32) -> i32 {
    match (side, other) {
        (true, false) => forward,
        (false, true) => backward,
        _ => 0,
    }
}
