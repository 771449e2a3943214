//! Repair of a tree after an augmentation: its orphans find parents again, each at its least distance, or leave the tree.
//!
//! Three passes (as in Goldberg et al., "Faster and more dynamic maximum flow by incremental breadth-first search",
//! ESA 2015): orphans by rising label take a parent at their own distance or are unlinked, with their children; the
//! unlinked measure their distance over linked neighbours; from the nearest on, they are linked again breadth first.
//! Each call does one node's part of one pass.

use super::trees::{beside, offsets};
use super::{FREE, GridCut, Node, ORPHAN, Repair, SINK, SOURCE, UNLINKED};

/// Residual capacity of the arc that would lead flow between `node` and its neighbour `near` as its parent.
const fn residual_to_parent<const TREE: u8>(node: &Node, near: &Node, k: usize) -> i32 {
    if TREE == SOURCE {
        near.residual[k ^ 1]
    } else {
        node.residual[k]
    }
}

impl GridCut {
    /// One step of the repair of a tree; false where it is whole.
    pub(super) fn repair<const TREE: u8>(&mut self) -> bool {
        let tree = &mut self.trees[usize::from(TREE - 1)];
        match tree.repair {
            Repair::Detach => {
                if let Some(i) = tree.orphans.pop(&self.nodes) {
                    self.adopt::<TREE>(i);
                } else if tree.unlinked.len() == 0 {
                    return false;
                } else {
                    tree.repair = Repair::Measure(0);
                }
            }
            Repair::Measure(k) => {
                if k < tree.unlinked.len() {
                    tree.repair = Repair::Measure(k + 1);
                    let i = tree.unlinked.get(k) as usize;
                    self.measure::<TREE>(i);
                } else {
                    tree.repair = Repair::Attach;
                }
            }
            Repair::Attach => self.attach::<TREE>(),
            Repair::Release(k) => {
                if k < tree.unlinked.len() {
                    tree.repair = Repair::Release(k + 1);
                    let i = tree.unlinked.get(k) as usize;
                    if self.nodes[i].parent == UNLINKED {
                        self.nodes[i].parent = ORPHAN;
                        self.nodes[i].tree = FREE;
                        self.wake_around::<TREE>(i);
                    }
                } else {
                    tree.unlinked.clear();
                    tree.repair = Repair::Detach;
                }
            }
        }
        true
    }

    /// Finds an orphan a parent at its own distance, or unlinks it and makes orphans of its children.
    fn adopt<const TREE: u8>(&mut self, i: usize) {
        let offsets = offsets(self.stride);
        let node = self.nodes[i];
        let mut children = [false; 4];
        for k in 0..4 {
            let near = &self.nodes[beside(i, offsets[k])];
            if near.tree != TREE {
                continue;
            }
            children[k] = usize::from(near.parent) == k ^ 1;
            if near.label + 1 == node.label
                && near.parent < ORPHAN
                && residual_to_parent::<TREE>(&node, near, k) > 0
            {
                self.nodes[i].parent = k as u8;
                return;
            }
        }
        for k in 0..4 {
            if children[k] {
                self.orphan::<TREE>(beside(i, offsets[k]));
            }
        }
        self.nodes[i].parent = UNLINKED;
        self.trees[usize::from(TREE - 1)].unlinked.push(i as u32);
    }

    /// The linked neighbour nearest to the terminal that can be a parent, and its label.
    fn nearest_parent<const TREE: u8>(&self, i: usize) -> Option<(usize, u32)> {
        let offsets = offsets(self.stride);
        let node = &self.nodes[i];
        let mut nearest: Option<(usize, u32)> = None;
        for k in 0..4 {
            let near = &self.nodes[beside(i, offsets[k])];
            if near.tree == TREE
                && near.parent < ORPHAN
                && nearest.is_none_or(|(_, label)| near.label < label)
                && residual_to_parent::<TREE>(node, near, k) > 0
            {
                nearest = Some((k, near.label));
            }
        }
        nearest
    }

    /// Labels of a tree are at most its depth, one more while it grows.
    const fn limit<const TREE: u8>(&self) -> u32 {
        let side = (TREE - 1) as usize;
        self.trees[side].depth + (self.growing == side) as u32
    }

    fn measure<const TREE: u8>(&mut self, i: usize) {
        if let Some((_, label)) = self.nearest_parent::<TREE>(i)
            && label < self.limit::<TREE>()
        {
            self.nodes[i].label = label + 1;
            self.trees[usize::from(TREE - 1)].orphans.push(&mut self.nodes, i);
        }
    }

    /// Links the nearest measured node, or the unlinked neighbours of one linked before, whichever is nearer.
    fn attach<const TREE: u8>(&mut self) {
        let tree = &mut self.trees[usize::from(TREE - 1)];
        let linked = tree.linked.front().map(|i| self.nodes[i as usize].label);
        let measured = tree.orphans.lowest();
        match (measured, linked) {
            (Some(label), _) if linked.is_none_or(|l| label <= l) => {
                let Some(i) = tree.orphans.pop(&self.nodes) else {
                    return;
                };
                if self.nodes[i].parent == UNLINKED
                    && let Some((k, _)) = self.nearest_parent::<TREE>(i)
                {
                    self.link::<TREE>(i, k, label);
                }
            }
            (_, Some(label)) => {
                let Some(i) = tree.linked.pop() else { return };
                if label < self.limit::<TREE>() {
                    self.link_neighbours::<TREE>(i as usize, label + 1);
                }
            }
            _ => tree.repair = Repair::Release(0),
        }
    }

    fn link_neighbours<const TREE: u8>(&mut self, i: usize, label: u32) {
        let offsets = offsets(self.stride);
        let node = self.nodes[i];
        for k in 0..4 {
            let j = beside(i, offsets[k]);
            let near = &self.nodes[j];
            if near.parent == UNLINKED
                && near.tree == TREE
                && residual_to_parent::<TREE>(near, &node, k ^ 1) > 0
            {
                self.link::<TREE>(j, k ^ 1, label);
            }
        }
    }

    fn link<const TREE: u8>(&mut self, i: usize, k: usize, label: u32) {
        self.nodes[i].parent = k as u8;
        self.nodes[i].label = label;
        let tree = &mut self.trees[usize::from(TREE - 1)];
        tree.linked.push(i as u32);
        if label >= tree.depth {
            self.enqueue::<TREE>(i);
        }
    }

    /// Has the other tree look again at a node that this tree gave up.
    fn wake_around<const TREE: u8>(&mut self, i: usize) {
        let offsets = offsets(self.stride);
        let node = self.nodes[i];
        for k in 0..4 {
            let j = beside(i, offsets[k]);
            let near = &self.nodes[j];
            if near.tree == FREE || near.tree == TREE {
                continue;
            }
            let residual = if TREE == SOURCE {
                node.residual[k]
            } else {
                near.residual[k ^ 1]
            };
            if residual > 0 && TREE == SOURCE {
                self.wake::<SINK>(j);
            } else if residual > 0 {
                self.wake::<SOURCE>(j);
            }
        }
    }

    fn wake<const TREE: u8>(&mut self, j: usize) {
        if self.nodes[j].label >= self.trees[usize::from(TREE - 1)].depth {
            self.enqueue::<TREE>(j);
        }
    }
}
