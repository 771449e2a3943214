//! The search: growth and augmentation.

use super::{CutState, FREE, GridCut, Node, ORPHAN, SINK, SOURCE, TERMINAL};

/// Steps between neighbours, in the order of `Node::residual`.
pub(super) const fn offsets(stride: usize) -> [isize; 4] {
    [1, -1, stride as isize, -(stride as isize)]
}

pub(super) const fn beside(index: usize, offset: isize) -> usize {
    index.wrapping_add_signed(offset)
}

impl GridCut {
    /// Runs until `max_steps` are used or the flow is a maximum; returns the steps used.
    pub(super) fn grow(&mut self, max_steps: u32) -> u32 {
        let mut steps = 0_u32;
        while steps < max_steps && self.state == CutState::Running {
            if self.repair::<SOURCE>() || self.repair::<SINK>() {
                steps += 1;
            } else if self.growing == 0 {
                steps += self.scan::<SOURCE>();
            } else {
                steps += self.scan::<SINK>();
            }
        }
        steps
    }

    /// Takes the tree with fewer nodes waiting one level further; done where either has none.
    pub(super) fn begin_phase(&mut self) {
        let [source, sink] = &self.trees;
        self.growing = usize::from(sink.next.len() < source.next.len());
        let tree = &mut self.trees[self.growing];
        if tree.next.len() == 0 {
            self.state = CutState::Done;
            return;
        }
        core::mem::swap(&mut tree.current, &mut tree.next);
    }

    /// Scans one node of the growing tree: takes free neighbours in, or augments once and returns to the node later.
    fn scan<const TREE: u8>(&mut self) -> u32 {
        let tree = &mut self.trees[usize::from(TREE - 1)];
        let i = match self.scanned.take() {
            Some(i) => i as usize,
            None => {
                let Some(i) = tree.current.pop() else {
                    tree.depth += 1;
                    self.begin_phase();
                    return 1;
                };
                self.nodes[i as usize].queued &= !TREE;
                i as usize
            }
        };
        let node = self.nodes[i];
        if node.tree != TREE {
            return 1;
        }
        if node.label > tree.depth {
            self.enqueue::<TREE>(i);
            return 1;
        }
        for (k, &offset) in offsets(self.stride).iter().enumerate() {
            let j = beside(i, offset);
            let near = &mut self.nodes[j];
            let residual = if TREE == SOURCE {
                node.residual[k]
            } else {
                near.residual[k ^ 1]
            };
            if residual == 0 || near.tree == TREE {
                continue;
            }
            if near.tree == FREE {
                near.tree = TREE;
                near.label = node.label + 1;
                near.parent = (k ^ 1) as u8;
                self.enqueue::<TREE>(j);
            } else {
                self.scanned = Some(i as u32);
                return 1 + if TREE == SOURCE {
                    self.augment(i, j, k)
                } else {
                    self.augment(j, i, k ^ 1)
                };
            }
        }
        1
    }

    /// Queues a node of the tree for the phase that its label asks for.
    pub(super) fn enqueue<const TREE: u8>(&mut self, i: usize) {
        let tree = &mut self.trees[usize::from(TREE - 1)];
        let node = &mut self.nodes[i];
        if node.queued & TREE != 0 {
            return;
        }
        node.queued |= TREE;
        let is_growing = self.growing == usize::from(TREE - 1);
        if is_growing && node.label <= tree.depth {
            tree.current.push(i as u32);
        } else {
            tree.next.push(i as u32);
        }
    }

    /// Pushes flow from the root of `i` in the source tree over arc `k` to `j` and the root of `j` in the sink tree.
    fn augment(&mut self, i: usize, j: usize, k: usize) -> u32 {
        let offsets = offsets(self.stride);
        let mut amount = self.nodes[i].residual[k];
        let mut length = 1;
        let mut at = i;
        loop {
            let parent = self.nodes[at].parent;
            if parent >= TERMINAL {
                break;
            }
            let up = beside(at, offsets[usize::from(parent)]);
            amount = amount.min(self.nodes[up].residual[usize::from(parent ^ 1)]);
            at = up;
            length += 1;
        }
        amount = amount.min(self.nodes[at].excess);
        at = j;
        loop {
            let Node { parent, residual, .. } = self.nodes[at];
            if parent >= TERMINAL {
                break;
            }
            amount = amount.min(residual[usize::from(parent)]);
            at = beside(at, offsets[usize::from(parent)]);
            length += 1;
        }
        amount = amount.min(-self.nodes[at].excess);

        self.nodes[i].residual[k] -= amount;
        self.nodes[j].residual[k ^ 1] += amount;
        self.lower += i64::from(amount);
        self.push_from_source(i, amount);
        self.push_to_sink(j, amount);
        length
    }

    fn push_from_source(&mut self, from: usize, amount: i32) {
        let offsets = offsets(self.stride);
        let mut at = from;
        loop {
            let parent = usize::from(self.nodes[at].parent);
            if parent >= usize::from(TERMINAL) {
                break;
            }
            let up = beside(at, offsets[parent]);
            self.nodes[at].residual[parent] += amount;
            let left = &mut self.nodes[up].residual[parent ^ 1];
            *left -= amount;
            if *left == 0 {
                self.orphan::<SOURCE>(at);
            }
            at = up;
        }
        self.nodes[at].excess -= amount;
        if self.nodes[at].excess == 0 {
            self.orphan::<SOURCE>(at);
        }
    }

    fn push_to_sink(&mut self, from: usize, amount: i32) {
        let offsets = offsets(self.stride);
        let mut at = from;
        loop {
            let parent = usize::from(self.nodes[at].parent);
            if parent >= usize::from(TERMINAL) {
                break;
            }
            let up = beside(at, offsets[parent]);
            self.nodes[up].residual[parent ^ 1] += amount;
            let left = &mut self.nodes[at].residual[parent];
            *left -= amount;
            if *left == 0 {
                self.orphan::<SINK>(at);
            }
            at = up;
        }
        self.nodes[at].excess += amount;
        if self.nodes[at].excess == 0 {
            self.orphan::<SINK>(at);
        }
    }

    pub(super) fn orphan<const TREE: u8>(&mut self, i: usize) {
        self.nodes[i].parent = ORPHAN;
        self.trees[usize::from(TREE - 1)].orphans.push(&mut self.nodes, i);
    }
}
