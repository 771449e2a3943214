//! What one world looks like: every choice the seed makes about a whole road.
//!
//! In: a seed and, where wanted, the kind of road. Out: widths, colours, densities, light. Seeds differ strongly, for the
//! frames also train the network. Colours are linear reflectances, red first.

use super::noise::Seeded;

/// The kind of road.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Narrow street between gardens, often unmarked.
    Residential,
    /// Houses, wide pavements, parked cars, people.
    Urban,
    /// Verges, trees and hedges; no kerb.
    Rural,
    /// Several lanes one way, shoulders and guard rails.
    Highway,
}

/// What lies beyond the pavement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Surface {
    /// Mown or wild grass.
    Grass,
    /// Slabs with joints.
    Slabs,
    /// Asphalt much like the road's.
    Tarmac,
    /// Earth or gravel.
    Gravel,
}

/// Every choice about a world.
#[derive(Clone, Debug)]
pub(super) struct Style {
    pub(super) kind: Kind,
    /// Half of the carriageway without parking bays.
    pub(super) half_width_m: f32,
    pub(super) width_sway_m: f32,
    /// Extra width of parking bays on each side, left first; 0 for none.
    pub(super) bay_m: [f32; 2],
    /// Ego lane's centre, left of the centre line.
    pub(super) ego_d: f32,
    /// Oncoming lane's centre; none on a one-way road.
    pub(super) oncoming_d: Option<f32>,
    pub(super) bend_rad: f32,
    pub(super) bend_length_m: f32,
    pub(super) side_street_every_m: f32,
    /// Height of pavement and verge over the road.
    pub(super) kerb_m: f32,
    /// Width of the pavement on each side, 0 for none.
    pub(super) pavement_m: [f32; 2],
    pub(super) pavement: Surface,
    pub(super) beyond: Surface,
    /// Strip of another stone along the kerb, part of the road.
    pub(super) gutter_m: f32,
    pub(super) road_rgb: [f32; 3],
    pub(super) pavement_rgb: [f32; 3],
    pub(super) beyond_rgb: [f32; 3],
    pub(super) kerb_rgb: [f32; 3],
    pub(super) gutter_rgb: [f32; 3],
    pub(super) marking_rgb: [f32; 3],
    pub(super) leaf_rgb: [f32; 3],
    /// Contrast of grain, cracks and stains on the road.
    pub(super) grain: f32,
    pub(super) cracks: f32,
    pub(super) stains: f32,
    /// Chance of a repair patch in each nine metres.
    pub(super) patches: f32,
    pub(super) centre_dashes: bool,
    pub(super) edge_lines: bool,
    pub(super) marking_wear: f32,
    /// Objects each hundred metres and side.
    pub(super) trees: f32,
    pub(super) houses: f32,
    pub(super) hedges: f32,
    pub(super) fences: f32,
    pub(super) posts: f32,
    pub(super) parked: f32,
    pub(super) people: f32,
    pub(super) oncoming_every_m: f32,
    /// Gap to the car ahead; none where the lane is empty.
    pub(super) lead_gap_m: Option<f32>,
    /// Unit vector to the sun.
    pub(super) sun: [f32; 3],
    pub(super) sun_rgb: [f32; 3],
    pub(super) sky_light_rgb: [f32; 3],
    pub(super) zenith_rgb: [f32; 3],
    pub(super) horizon_rgb: [f32; 3],
    pub(super) clouds: f32,
    /// Distance over which haze halves the contrast.
    pub(super) haze_m: f32,
    /// Height of the far tree line over the horizon, as a slope.
    pub(super) skyline: f32,
    /// Exposure that brings a grey road in full light to the middle of the range.
    pub(super) exposure: f32,
}

fn tint(random: &mut Seeded, tone: f32, spread: f32) -> [f32; 3] {
    [0; 3].map(|_| tone * (1.0 + random.range(-spread, spread)))
}

impl Style {
    /// The style of `seed`, of a given kind or one the seed picks.
    #[expect(clippy::too_many_lines, reason = "one flat list of independent choices")]
    pub(super) fn new(seed: u64, kind: Option<Kind>) -> Self {
        let mut r = Seeded::new(seed, 2);
        let chosen = r.pick(&[
            Kind::Residential,
            Kind::Residential,
            Kind::Residential,
            Kind::Urban,
            Kind::Urban,
            Kind::Rural,
            Kind::Highway,
        ]);
        let kind = kind.unwrap_or(chosen);
        let highway = kind == Kind::Highway;
        let rural = kind == Kind::Rural;
        let urban = kind == Kind::Urban;
        let residential = kind == Kind::Residential;
        let half_width_m = match kind {
            Kind::Residential => r.range(2.7, 4.0),
            Kind::Urban => r.range(3.2, 4.6),
            Kind::Rural => r.range(2.8, 3.8),
            Kind::Highway => r.range(5.5, 8.0),
        };
        // Left-hand traffic in a third of the worlds.
        let traffic_side = if r.chance(0.33) { 1.0 } else { -1.0 };
        let lane = if highway { r.range(-0.45, 0.3) } else { 0.5 } * half_width_m;
        let ego_d = traffic_side
            * if residential {
                lane * r.range(0.6, 1.0)
            } else {
                lane
            };
        let bay = |r: &mut Seeded| {
            if !rural && !highway && r.chance(0.5) {
                r.range(1.9, 2.3)
            } else {
                0.0
            }
        };
        let bay_m = [bay(&mut r), bay(&mut r)];
        let width = |r: &mut Seeded| {
            if rural || highway || (residential && r.chance(0.25)) {
                0.0
            } else {
                r.range(1.2, 3.5)
            }
        };
        let pavement_m = [width(&mut r), width(&mut r)];
        let kerbless = rural || highway || (residential && r.chance(0.15));

        let road_tone = if r.chance(0.25) {
            r.range(0.05, 0.09)
        } else {
            r.range(0.09, 0.26)
        };
        let road_rgb = tint(&mut r, road_tone, 0.05);
        let pavement = r.pick(&[
            Surface::Slabs,
            Surface::Slabs,
            Surface::Tarmac,
            Surface::Tarmac,
            Surface::Gravel,
        ]);
        let pavement_rgb = match pavement {
            // As in many streets, hardly told from the road by colour alone.
            Surface::Tarmac => {
                let like = r.range(0.8, 1.3);
                let own = tint(&mut r, 1.0, 0.04);
                [0, 1, 2].map(|i| road_rgb[i] * like * own[i])
            }
            Surface::Gravel => {
                let tone = r.range(0.16, 0.3);
                [tone * 1.1, tone, tone * 0.85]
            }
            _ => {
                let tone = r.range(0.14, 0.4);
                let warm = r.range(0.95, 1.15);
                [tone * warm, tone, tone * r.range(0.8, 1.0)]
            }
        };
        let beyond = if urban {
            r.pick(&[Surface::Grass, Surface::Slabs, Surface::Tarmac])
        } else {
            r.pick(&[Surface::Grass, Surface::Grass, Surface::Grass, Surface::Gravel])
        };
        let green = r.range(0.5, 1.2);
        let beyond_rgb = match beyond {
            Surface::Grass => [0.11 * r.range(0.6, 1.5), 0.14 * green, 0.05 * r.range(0.6, 1.2)],
            Surface::Gravel => [0.24 * green, 0.2 * green, 0.15 * green],
            Surface::Slabs | Surface::Tarmac => tint(&mut r, road_tone * green + 0.05, 0.08),
        };
        let kerb_tone = r.range(0.14, 0.42);
        let kerb_rgb = tint(&mut r, kerb_tone, 0.04);
        let gutter_tone = road_tone * r.range(0.7, 1.7);
        let gutter_rgb = tint(&mut r, gutter_tone, 0.04);
        let yellow = r.chance(0.12);
        let marking_tone = r.range(0.45, 0.75);
        let marking_rgb = [
            marking_tone,
            marking_tone * if yellow { 0.75 } else { 0.98 },
            marking_tone * if yellow { 0.2 } else { 0.95 },
        ];
        let leaf_tone = r.range(0.5, 1.2);
        let leaf_rgb = [
            0.1 * leaf_tone * r.range(0.6, 1.5),
            0.14 * leaf_tone,
            0.045 * leaf_tone * r.range(0.6, 1.4),
        ];

        let sunny = r.chance(0.65);
        let height = r.range(0.3, 1.15);
        let azimuth = r.range(-std::f32::consts::PI, std::f32::consts::PI);
        let sun = [
            azimuth.cos() * height.cos(),
            azimuth.sin() * height.cos(),
            height.sin(),
        ];
        let power = if sunny { r.range(1.5, 4.5) } else { 0.0 };
        let warm = 0.25 * (0.7 - height).max(0.0) + r.range(0.0, 0.1);
        let sun_rgb = [power * (1.0 + warm), power, power * (1.0 - 1.5 * warm)];
        let sky_tone = if sunny {
            r.range(0.5, 0.95)
        } else {
            r.range(0.8, 1.1)
        };
        let blue = if sunny {
            r.range(0.05, 0.3)
        } else {
            r.range(0.0, 0.08)
        };
        let sky_light_rgb = [sky_tone * (1.0 - blue), sky_tone, sky_tone * (1.0 + blue)];
        let clouds = if sunny {
            r.range(0.0, 0.7)
        } else {
            r.range(0.8, 1.0)
        };
        let light = sky_tone + power * height.sin();
        let marked = match kind {
            Kind::Residential => 0.3,
            Kind::Urban => 0.75,
            Kind::Rural => 0.75,
            Kind::Highway => 1.0,
        };
        let scale = if highway { 0.3 } else { 1.0 };
        Self {
            kind,
            half_width_m,
            width_sway_m: if highway { 0.0 } else { r.range(0.0, 0.25) },
            bay_m,
            ego_d,
            oncoming_d: (!highway).then_some(-traffic_side * 0.5 * half_width_m),
            bend_rad: r.range(0.1, if highway { 0.35 } else { 0.75 }),
            bend_length_m: if highway {
                r.range(180.0, 300.0)
            } else {
                r.range(75.0, 150.0)
            },
            side_street_every_m: if urban || residential {
                r.range(45.0, 160.0)
            } else {
                0.0
            },
            kerb_m: if kerbless {
                r.range(0.0, 0.03)
            } else {
                r.range(0.08, 0.15)
            },
            pavement_m,
            pavement,
            beyond,
            gutter_m: if !kerbless && r.chance(0.5) {
                r.range(0.15, 0.4)
            } else {
                0.0
            },
            road_rgb,
            pavement_rgb,
            beyond_rgb,
            kerb_rgb,
            gutter_rgb,
            marking_rgb,
            leaf_rgb,
            grain: r.range(0.5, 1.3),
            cracks: if r.chance(0.7) { r.range(0.1, 0.7) } else { 0.0 },
            stains: r.range(0.1, 0.6),
            patches: if highway { 0.05 } else { r.range(0.0, 0.5) },
            centre_dashes: r.chance(marked),
            edge_lines: r.chance(if urban || residential { 0.25 } else { 0.85 }),
            marking_wear: r.range(0.0, 0.8),
            trees: scale * r.range(1.0, if urban { 8.0 } else { 18.0 }),
            houses: if rural { 0.4 } else { scale * r.range(2.0, 6.5) },
            hedges: scale
                * if urban {
                    r.range(0.0, 4.0)
                } else {
                    r.range(1.0, 9.0)
                },
            fences: if highway { 25.0 } else { r.range(0.0, 5.0) },
            posts: r.range(1.0, 5.0),
            parked: if urban || residential {
                r.range(0.0, 9.0)
            } else {
                0.0
            },
            people: if urban {
                r.range(1.0, 8.0)
            } else if residential {
                r.range(0.0, 3.0)
            } else {
                0.0
            },
            oncoming_every_m: r.range(35.0, 200.0),
            lead_gap_m: r
                .chance(if highway { 0.7 } else { 0.4 })
                .then(|| r.range(12.0, 45.0)),
            sun,
            sun_rgb,
            sky_light_rgb,
            zenith_rgb: [0.35 * sky_tone, 0.62 * sky_tone, 1.2 * sky_tone],
            horizon_rgb: [1.25 * sky_tone, 1.35 * sky_tone, 1.45 * sky_tone],
            clouds,
            haze_m: if r.chance(0.2) {
                r.range(90.0, 250.0)
            } else {
                r.range(300.0, 2000.0)
            },
            skyline: r.range(0.01, 0.12),
            exposure: r.range(0.16, 0.3) / (light * (0.5 * road_tone + 0.09)),
        }
    }
}
