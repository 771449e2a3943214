//! Sets a problem up, from nothing or from the flow of the same problem at half resolution.

use super::{CutState, EMPTY_NODE, GridCut, GridProblem, Repair, SINK, SOURCE, TERMINAL};

impl GridCut {
    /// Begins `problem` with the labelling that its unaries alone would take.
    ///
    /// # Panics
    /// Where the problem is not of this solver's size.
    pub fn start(&mut self, problem: &GridProblem<'_>) {
        self.set_up(problem, |_, _| [0, 0]);
    }

    /// Begins `problem` with the flow and the labelling of `half`, a cut of the problem summed over 2x2 pixels.
    ///
    /// # Panics
    /// Where the problem is not of this solver's size, or `half` not of half that size, rounded up.
    pub fn start_from_half(&mut self, problem: &GridProblem<'_>, half: &Self) {
        assert!(half.width == self.width.div_ceil(2) && half.height == self.height.div_ceil(2));
        let share = |flow: i32, capacity: i32, total: i32| {
            if total == 0 {
                0
            } else {
                (i64::from(flow) * i64::from(capacity) / i64::from(total)) as i32
            }
        };
        let width = self.width;
        self.set_up(problem, |x, y| {
            let p = y * width + x;
            let node = half.index(x / 2, y / 2);
            let mut flow = [0, 0];
            // Two fine arcs cross each side of a coarse pixel and share its flow by capacity; arcs inside it start empty.
            if x % 2 == 1 && x + 1 < width {
                let (out, back) = (half.nodes[node].residual[0], half.nodes[node + 1].residual[1]);
                flow[0] = share((back - out) / 2, problem.right[p], i32::midpoint(out, back));
            }
            if y % 2 == 1 && y + 1 < problem.height {
                let (out, back) = (
                    half.nodes[node].residual[2],
                    half.nodes[node + half.stride].residual[3],
                );
                flow[1] = share((back - out) / 2, problem.down[p], i32::midpoint(out, back));
            }
            flow
        });
        let energy = self.energy_of(|_, p| half.best[p / width / 2 * half.width + p % width / 2] != 0);
        if energy < self.upper {
            self.upper = energy;
            for p in 0..self.best.len() {
                self.best[p] = half.best[p / width / 2 * half.width + p % width / 2];
            }
        }
    }

    /// Fills the residual graph of `problem` under the flow `(x, y) -> [right, down]`, and the roots of both trees.
    fn set_up(&mut self, problem: &GridProblem<'_>, flow: impl Fn(usize, usize) -> [i32; 2]) {
        assert!(problem.width == self.width && problem.height == self.height);
        self.nodes.fill(EMPTY_NODE);
        for tree in &mut self.trees {
            tree.depth = 1;
            tree.current.clear();
            tree.next.clear();
            tree.orphans.clear();
            tree.unlinked.clear();
            tree.linked.clear();
            tree.repair = Repair::Detach;
        }
        self.lower = 0;
        for y in 0..self.height {
            let row = self.index(0, y);
            for x in 0..self.width {
                let (p, i) = (y * self.width + x, row + x);
                let flow = flow(x, y);
                let excess = problem.source[p] - problem.sink[p];
                self.best[p] = u8::from(excess > 0);
                self.lower += i64::from(problem.sink[p]);
                self.nodes[i].excess += excess - flow[0] - flow[1];
                if x + 1 < self.width {
                    self.nodes[i].residual[0] = problem.right[p] - flow[0];
                    self.nodes[i + 1].residual[1] = problem.right[p] + flow[0];
                    self.nodes[i + 1].excess += flow[0];
                }
                if y + 1 < self.height {
                    let below = i + self.stride;
                    self.nodes[i].residual[2] = problem.down[p] - flow[1];
                    self.nodes[below].residual[3] = problem.down[p] + flow[1];
                    self.nodes[below].excess += flow[1];
                }
                // Later pixels add nothing to this one any more.
                let excess = self.nodes[i].excess;
                self.lower += i64::from(excess.min(0));
                self.plant(i, excess);
            }
        }
        let best = &self.best;
        self.upper = self.energy_of(|_, p| best[p] != 0);
        self.best_lower = self.lower;
        self.growing = 0;
        self.scanned = None;
        self.steps_since_priced = 0;
        self.state = CutState::Running;
        self.begin_phase();
        // Without a root on one side there is nothing to search, and the trees as planted hold the minimum.
        if self.state == CutState::Done {
            self.price();
        }
    }

    /// Makes a pixel with terminal capacity left the root that it is.
    fn plant(&mut self, i: usize, excess: i32) {
        if excess == 0 {
            return;
        }
        let tree = if excess > 0 { SOURCE } else { SINK };
        let node = &mut self.nodes[i];
        node.tree = tree;
        node.label = 1;
        node.parent = TERMINAL;
        node.queued = tree;
        self.trees[usize::from(tree - 1)].next.push(i as u32);
    }
}
