//! What stands beside the road, and what moves on it.
//!
//! In: road and style. Out: [`Object`]s, each a run of [`Part`]s, sorted by their place along the road; and the parts of
//! movers at any time. Invariant: nothing stands on the carriageway but vehicles, and none in the ego lane.
//! Cost: a frame looks at the objects within [`NEAR_M`] only.
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_precision_loss,
    reason = "counts and indices are far below 2^24"
)]

use super::build::{car, fence, hedge, house, person, post, tree};
use super::noise::{Seeded, wave};
use super::road::{BEHIND_M, BEYOND_M, Road};
use super::shape::Part;
use super::style::{Kind, Style};

/// Objects farther than this from the camera are not drawn.
pub(super) const NEAR_M: f32 = 130.0;

/// A run of parts with its bounding cylinder.
#[derive(Clone, Copy, Debug)]
pub(super) struct Object {
    pub(super) s: f32,
    pub(super) centre: [f32; 2],
    pub(super) radius: f32,
    pub(super) first: usize,
    pub(super) count: usize,
}

/// Half length and half width of the place that a car on the verge takes, up to [`CAR_TOP_M`].
const CAR_PLACE_M: [f32; 2] = [2.8, 1.0];
const CAR_TOP_M: f32 = 2.3;

/// Where a builder puts things: a world position, heading, and the list of parts.
#[derive(Debug, Default, Clone)]
pub(super) struct Scene {
    pub(super) parts: Vec<Part>,
    pub(super) objects: Vec<Object>,
}

impl Scene {
    /// Everything that never moves.
    pub(super) fn new(seed: u64, road: &Road, style: &Style, length_m: f64) -> Self {
        let mut scene = Self::default();
        let mut random = Seeded::new(seed, 3);
        let end = (length_m + BEYOND_M) as f32;
        for side in 0..2 {
            let row = Row {
                road,
                style,
                side,
                end,
            };
            row.houses(&mut scene, &mut random);
            row.barrier(&mut scene, &mut random, style.hedges, true);
            row.barrier(&mut scene, &mut random, style.fences, false);
            row.trees(&mut scene, &mut random);
            row.posts(&mut scene, &mut random);
            row.parked(&mut scene, &mut random);
        }
        scene.objects.sort_by(|a, b| a.s.total_cmp(&b.s));
        scene
    }

    /// Adds an object from the parts that `build` appends.
    pub(super) fn add(&mut self, s: f32, build: impl FnOnce(&mut Vec<Part>)) {
        let first = self.parts.len();
        build(&mut self.parts);
        let parts = &self.parts[first..];
        let Some(head) = parts.first() else { return };
        let centre = [head.base[0], head.base[1]];
        let radius = parts
            .iter()
            .map(|p| {
                let [a, b] = p.half_extent();
                (p.base[0] - centre[0]).hypot(p.base[1] - centre[1]) + a.hypot(b)
            })
            .fold(0.0, f32::max);
        self.objects.push(Object {
            s,
            centre,
            radius,
            first,
            count: parts.len(),
        });
    }

    /// Takes away what stands where a car is to stand: at `[x, y]`, pointing along `heading`.
    fn make_room_for_car(&mut self, [x, y]: [f32; 2], heading: f32) {
        let (sin, cos) = heading.sin_cos();
        let is_in_place = |part: &Part| {
            // What is long lies along the road, as the car does.
            let [half_along, half_across] = part.half_extent();
            let (east, north) = (part.base[0] - x, part.base[1] - y);
            let along = (east * cos + north * sin).abs() - half_along;
            let across = (north * cos - east * sin).abs() - half_across;
            part.base[2] < CAR_TOP_M && along < CAR_PLACE_M[0] && across < CAR_PLACE_M[1]
        };
        let parts = &self.parts;
        (self.objects).retain(|o| !parts[o.first..o.first + o.count].iter().any(is_in_place));
    }

    /// The objects between two places along the road.
    pub(super) fn between(&self, from_s: f32, to_s: f32) -> &[Object] {
        let start = self.objects.partition_point(|o| o.s < from_s);
        let end = self.objects.partition_point(|o| o.s <= to_s);
        &self.objects[start..end.max(start)]
    }
}

/// One side of the road while it is furnished.
struct Row<'a> {
    road: &'a Road,
    style: &'a Style,
    side: usize,
    end: f32,
}

impl Row<'_> {
    fn sign(&self) -> f32 {
        if self.side == 0 { 1.0 } else { -1.0 }
    }

    /// `(x, y, heading)` at `beyond` metres outside the kerb.
    fn place(&self, s: f32, beyond: f32) -> (f32, f32, f32) {
        let d = self.sign() * (self.road.half_width(s, self.side) + beyond);
        let (x, y, heading) = self.road.world(f64::from(s), f64::from(d));
        (x as f32, y as f32, heading as f32)
    }

    /// Whether `reach` metres around are free of side streets.
    fn clear(&self, s: f32, reach: f32) -> bool {
        self.road.gap(s, self.side) > reach
    }

    /// Where front gardens begin.
    fn front_m(&self) -> f32 {
        self.style.pavement_m[self.side]
            + if self.style.kind == Kind::Highway {
                2.0
            } else {
                0.3
            }
    }

    /// Walks the side with gaps around `100 / each_hundred` metres.
    fn walk(&self, random: &mut Seeded, each_hundred: f32, mut visit: impl FnMut(&mut Seeded, f32)) {
        if each_hundred <= 0.05 {
            return;
        }
        let pitch = 100.0 / each_hundred;
        let mut s = -BEHIND_M as f32 + random.range(0.0, pitch);
        while s < self.end {
            visit(random, s);
            s += pitch * random.range(0.5, 1.5);
        }
    }

    fn houses(&self, scene: &mut Scene, random: &mut Seeded) {
        let style = self.style;
        let garden = if style.kind == Kind::Urban {
            random.range(0.2, 4.0)
        } else {
            random.range(3.0, 9.0)
        };
        let mut s = -BEHIND_M as f32;
        let pitch = 100.0 / style.houses.max(0.1);
        while s < self.end {
            let half_front = random.range(4.5, 8.5).min(0.5 * pitch.max(9.0));
            let half_deep = random.range(4.0, 6.0);
            s += half_front;
            if self.clear(s, half_front + style.pavement_m[self.side] + 1.5) {
                let set_back = self.front_m() + garden + random.range(0.0, 0.3 * garden) + half_deep;
                let (x, y, heading) =
                    self.place(s, set_back + if style.kind == Kind::Highway { 20.0 } else { 0.4 });
                let storeys = random
                    .range(2.0, if style.kind == Kind::Urban { 5.5 } else { 3.2 })
                    .floor();
                scene.add(s, |parts| {
                    house(parts, random, [x, y], heading, [half_front, half_deep], storeys)
                });
            }
            s += half_front + (pitch - 2.0 * half_front).max(0.3) * random.range(0.6, 1.6);
        }
    }

    /// Runs of hedge, wall or fence along the front gardens.
    fn barrier(&self, scene: &mut Scene, random: &mut Seeded, each_hundred: f32, green: bool) {
        let style = self.style;
        let highway = style.kind == Kind::Highway;
        let height = if green {
            random.range(0.7, 2.4)
        } else {
            random.range(0.5, 1.7)
        };
        let kind = random.word();
        let length = 4.0;
        // Runs where a slow wave is high enough.
        let least = if highway { -2.0 } else { 0.75 - 0.2 * each_hundred };
        let mut s = -BEHIND_M as f32;
        while s < self.end {
            s += length;
            if wave(kind, s / 24.0) < least
                || !self.clear(s, length * 0.5 + style.pavement_m[self.side] + 0.5)
            {
                continue;
            }
            let (x, y, heading) = self.place(s, if highway { 0.8 } else { self.front_m() + 0.5 });
            let tall = height * random.range(0.9, 1.1);
            scene.add(s, |parts| {
                if green {
                    hedge(parts, random, [x, y], heading, 0.5 * length + 0.1, tall, style);
                } else {
                    fence(
                        parts,
                        random,
                        [x, y],
                        heading,
                        0.5 * length + 0.05,
                        if highway { 0.75 } else { height },
                        kind,
                    );
                }
            });
        }
    }

    fn trees(&self, scene: &mut Scene, random: &mut Seeded) {
        let style = self.style;
        let size = random.range(0.7, 1.25);
        self.walk(random, style.trees, |random, s| {
            let back = if random.chance(0.35) && style.kind != Kind::Highway {
                0.9
            } else {
                self.front_m() + random.range(1.2, 9.0)
            };
            if self.clear(s, style.pavement_m[self.side] + 1.5) {
                let (x, y, _) = self.place(s, back);
                scene.add(s, |parts| tree(parts, random, [x, y], size, style));
            }
        });
    }

    fn posts(&self, scene: &mut Scene, random: &mut Seeded) {
        let style = self.style;
        self.walk(random, style.posts, |random, s| {
            if self.clear(s, 1.0) {
                let (x, y, heading) = self.place(s, 0.5);
                let towards = heading - self.sign() * std::f32::consts::FRAC_PI_2;
                scene.add(s, |parts| post(parts, random, [x, y], towards));
            }
        });
    }

    fn parked(&self, scene: &mut Scene, random: &mut Seeded) {
        let style = self.style;
        let mut free_from = f32::MIN;
        self.walk(random, style.parked, |random, s| {
            if s < free_from || !self.clear(s, 7.0) {
                return;
            }
            let bay = self
                .road
                .bay(s - 2.5, self.side, style)
                .min(self.road.bay(s + 2.5, self.side, style))
                > 0.95;
            let width = style.pavement_m[self.side];
            let inside = if bay {
                -1.05
            } else if width > 2.2 {
                // Two wheels on the pavement, where the ego lane stays free.
                -0.25
            } else if width == 0.0 && style.kind != Kind::Highway {
                1.2
            } else {
                return;
            };
            free_from = s + 6.0;
            let (x, y, heading) = self.place(s, inside);
            let back = random.chance(0.2);
            let yaw = heading + random.range(-0.04, 0.04) + if back { std::f32::consts::PI } else { 0.0 };
            let is_on_verge = inside > 0.0;
            if is_on_verge {
                scene.make_room_for_car([x, y], heading);
            }
            let floor = if is_on_verge { style.kerb_m } else { 0.0 };
            scene.add(s, |parts| car(parts, random, [x, y, floor], yaw));
        });
    }
}

/// One vehicle or person that moves.
#[derive(Clone, Copy, Debug)]
enum Mover {
    /// Ahead in the ego lane; keeps its gap.
    Lead { gap_m: f32 },
    /// Comes towards the ego car.
    Oncoming { start_s: f32, mps: f32 },
    /// Walks along the pavement.
    Walker { start_s: f32, mps: f32, d: f32 },
    /// Crosses while the ego car is still far off.
    Crosser { s: f32, from_d: f32 },
}

/// Everything that moves, as functions of time.
#[derive(Clone, Debug)]
pub(super) struct Traffic {
    seed: u64,
    movers: Vec<Mover>,
}

impl Traffic {
    /// Draws the traffic of a drive of `length_m`.
    pub(super) fn new(seed: u64, road: &Road, style: &Style, length_m: f64) -> Self {
        let mut random = Seeded::new(seed, 4);
        let mut movers = Vec::new();
        let end = length_m as f32;
        if let Some(gap_m) = style.lead_gap_m {
            movers.push(Mover::Lead { gap_m });
        }
        if style.oncoming_d.is_some() {
            let mps = random.range(6.0, 13.0);
            let mut start_s = random.range(20.0, 120.0);
            while start_s < 3.0 * end + 200.0 {
                movers.push(Mover::Oncoming { start_s, mps });
                start_s += style.oncoming_every_m * random.range(0.6, 2.0);
            }
        }
        if style.people > 0.0 {
            let mut s = random.range(-30.0, 20.0);
            while s < end + 120.0 {
                let side = random.pick(&[0_usize, 1]);
                let sign = if side == 0 { 1.0 } else { -1.0 };
                let edge = road.half_width(s, side);
                let width = style.pavement_m[side];
                if random.chance(0.12) {
                    movers.push(Mover::Crosser {
                        s,
                        from_d: sign * (edge + 0.8),
                    });
                } else if width > 0.9 {
                    let mps = random.range(0.6, 1.6) * random.pick(&[1.0, -1.0]);
                    movers.push(Mover::Walker {
                        start_s: s,
                        mps,
                        d: sign * (edge + width * random.range(0.4, 0.9)),
                    });
                }
                s += 100.0 / style.people * random.range(0.3, 1.7);
            }
        }
        Self { seed, movers }
    }

    /// Writes the parts of every mover near `ego_s` at time `seconds`; `scene` is cleared first.
    pub(super) fn fill(&self, scene: &mut Scene, road: &Road, style: &Style, ego_s: f64, seconds: f64) {
        scene.parts.clear();
        scene.objects.clear();
        let ego = ego_s as f32;
        for (i, mover) in self.movers.iter().enumerate() {
            let (s, d, turned, stride) = match *mover {
                Mover::Lead { gap_m } => (ego + gap_m, style.ego_d, false, 0.0),
                Mover::Oncoming { start_s, mps } => {
                    let d = style.oncoming_d.unwrap_or(0.0);
                    (
                        (f64::from(start_s) - f64::from(mps) * seconds) as f32,
                        d,
                        true,
                        0.0,
                    )
                }
                Mover::Walker { start_s, mps, d } => {
                    let gone = f64::from(mps) * seconds;
                    ((f64::from(start_s) + gone) as f32, d, mps < 0.0, gone as f32)
                }
                Mover::Crosser { s, from_d } => {
                    let done = ((65.0 - (s - ego)) / 40.0).clamp(0.0, 1.0);
                    (s, from_d * (1.0 - 2.0 * done), false, 2.0 * from_d * done)
                }
            };
            if (s - ego).abs() > NEAR_M {
                continue;
            }
            let mut random = Seeded::new(self.seed, 1000 + i as u64);
            let (x, y, heading) = road.world(f64::from(s), f64::from(d));
            let (x, y, heading) = (x as f32, y as f32, heading as f32);
            let yaw = heading + if turned { std::f32::consts::PI } else { 0.0 };
            match mover {
                Mover::Lead { .. } | Mover::Oncoming { .. } => {
                    scene.add(s, |parts| car(parts, &mut random, [x, y, 0.0], yaw));
                }
                Mover::Walker { .. } | Mover::Crosser { .. } => {
                    let across = matches!(mover, Mover::Crosser { .. });
                    let yaw = if across {
                        heading - d.signum() * std::f32::consts::FRAC_PI_2
                    } else {
                        yaw
                    };
                    let floor = if road.edge(s, d) > 0.0 { style.kerb_m } else { 0.0 };
                    scene.add(s, |parts| person(parts, &mut random, [x, y, floor], yaw, stride));
                }
            }
        }
    }
}
