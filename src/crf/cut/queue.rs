//! Fixed queues of node indices: a ring for nodes to scan, buckets by label for orphans.

use alloc::boxed::Box;
use alloc::vec;

use super::Node;

/// First in, first out. The caller queues a node at most once, so the capacity is the number of nodes.
#[derive(Clone, Debug)]
pub(super) struct Ring {
    items: Box<[u32]>,
    head: usize,
    len: usize,
}

impl Ring {
    pub(super) fn new(capacity: usize) -> Self {
        Self {
            items: vec![0; capacity.max(1)].into_boxed_slice(),
            head: 0,
            len: 0,
        }
    }

    pub(super) fn clear(&mut self) {
        self.head = 0;
        self.len = 0;
    }

    pub(super) const fn len(&self) -> usize {
        self.len
    }

    pub(super) fn push(&mut self, item: u32) {
        debug_assert!(self.len < self.items.len());
        let mut at = self.head + self.len;
        if at >= self.items.len() {
            at -= self.items.len();
        }
        self.items[at] = item;
        self.len += 1;
    }

    pub(super) fn front(&self) -> Option<u32> {
        (self.len > 0).then(|| self.items[self.head])
    }

    /// The item `k` places behind the front of a ring that was only pushed to since it was cleared.
    pub(super) fn get(&self, k: usize) -> u32 {
        self.items[k]
    }

    pub(super) fn pop(&mut self) -> Option<u32> {
        if self.len == 0 {
            return None;
        }
        let item = self.items[self.head];
        self.head += 1;
        if self.head == self.items.len() {
            self.head = 0;
        }
        self.len -= 1;
        Some(item)
    }
}

/// Orphans by label, smallest first; the lists run through `Node::next_orphan`. Index 0 is padding and ends a list.
#[derive(Clone, Debug)]
pub(super) struct OrphanBuckets {
    heads: Box<[u32]>,
    lowest: usize,
    len: usize,
}

impl OrphanBuckets {
    pub(super) fn new(labels: usize) -> Self {
        Self {
            heads: vec![0; labels].into_boxed_slice(),
            lowest: 0,
            len: 0,
        }
    }

    pub(super) fn clear(&mut self) {
        self.heads.fill(0);
        self.lowest = 0;
        self.len = 0;
    }

    /// The smallest label queued.
    pub(super) fn lowest(&mut self) -> Option<u32> {
        if self.len == 0 {
            return None;
        }
        while self.heads[self.lowest] == 0 {
            self.lowest += 1;
        }
        Some(self.lowest as u32)
    }

    pub(super) fn push(&mut self, nodes: &mut [Node], index: usize) {
        // Labels are at most the number of pixels; the clamp keeps a violation of that slow rather than fatal.
        let label = (nodes[index].label as usize).min(self.heads.len() - 1);
        nodes[index].next_orphan = self.heads[label];
        self.heads[label] = index as u32;
        if self.len == 0 || label < self.lowest {
            self.lowest = label;
        }
        self.len += 1;
    }

    pub(super) fn pop(&mut self, nodes: &[Node]) -> Option<usize> {
        self.lowest()?;
        let index = self.heads[self.lowest] as usize;
        self.heads[self.lowest] = nodes[index].next_orphan;
        self.len -= 1;
        Some(index)
    }
}
