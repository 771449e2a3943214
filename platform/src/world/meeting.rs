//! Where a span of rays meets the ground, and what it looks like there.
//!
//! In: rays, and how far each may go. Out: distances, labels, radiance. The road lies on z = 0, everything beside it at
//! the kerb's height. Between the ends of a span, road coordinates are taken as linear along the ground, unless a kerb
//! could come between: then every ray is followed on its own, so that labels and depths stay exact.
//! Cost: four look-ups of road coordinates a span, at a kerb up to sixteen.

use super::World;
use super::ground::{Footprint, Places};
use super::lanes::{Colours, LANES, Lanes, lanes, ray};
use super::raster::View;
use super::window::Window;

/// Rays that point less far down than this never meet the ground.
const LEAST_FALL: f32 = 1e-4;

/// What one ray meets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Met {
    /// Nothing before its limit.
    Nothing,
    /// Raised ground too far off to have road coordinates.
    Beyond,
    /// The kerb's upright face.
    Face,
    /// Raised ground.
    Raised,
    /// The road.
    Road,
}

/// What a span of rays meets.
#[derive(Clone, Copy, Debug)]
pub(super) struct Meetings {
    pub(super) met: [Met; LANES],
    /// Along the unit rays.
    pub(super) distance: Lanes,
    places: Places,
    /// Change of `s` along x and y.
    turn: [f32; 2],
    /// A ray that meets ground.
    typical: usize,
}

/// The ground as seen from one place.
#[derive(Clone, Copy, Debug)]
pub(super) struct Eye<'a> {
    pub(super) world: &'a World,
    pub(super) window: &'a Window,
    pub(super) view: &'a View,
}

/// How a frame is taken.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shutter {
    pub(super) pixel_rad: f32,
    /// Way of the car while the shutter is open.
    pub(super) blur_m: f32,
}

/// Road coordinates of a place, the change of `s`, the signed distance outside the kerb, and the place.
type Located = ([f32; 2], [f32; 2], f32, [f32; 2]);

impl Eye<'_> {
    /// What the rays meet before their limits; none where no ray meets anything.
    #[inline]
    pub(super) fn meet(&self, rays: &[Lanes; 3], limits: &Lanes) -> Option<Meetings> {
        let height = self.view.origin[2] - self.world.style.kerb_m;
        let raised = lanes(|i| {
            if rays[2][i] < -LEAST_FALL {
                height / -rays[2][i]
            } else {
                f32::INFINITY
            }
        });
        if (0..LANES).all(|i| raised[i] >= limits[i]) {
            return None;
        }
        let flat = lanes(|i| self.view.origin[2] / -rays[2][i]);
        if let Some(meetings) = self.smooth(rays, limits, &raised, &flat) {
            return Some(meetings);
        }
        Some(self.each(rays, limits, &raised, &flat))
    }

    #[inline]
    fn at(&self, ray: [f32; 3], distance: f32) -> Option<Located> {
        let x = self.view.origin[0] + distance * ray[0];
        let y = self.view.origin[1] + distance * ray[1];
        let (place, turn) = self.window.at(x, y)?;
        Some((place, turn, self.world.road.edge(place[0], place[1]), [x, y]))
    }

    /// The span as a straight line on one of the two planes, where no kerb can lie between its ends.
    fn smooth(&self, rays: &[Lanes; 3], limits: &Lanes, raised: &Lanes, flat: &Lanes) -> Option<Meetings> {
        const LAST: usize = LANES - 1;
        if rays[2][0] >= -LEAST_FALL || rays[2][LAST] >= -LEAST_FALL {
            return None;
        }
        let ends = |distance: &Lanes| {
            let a = self.at(ray(rays, 0), distance[0])?;
            let b = self.at(ray(rays, LAST), distance[LAST])?;
            // The distance to the edge changes by less than two metres a metre.
            let apart = 2.0 * (b.3[0] - a.3[0]).hypot(b.3[1] - a.3[1]);
            Some((a, b, apart))
        };
        let (mut a, mut b, mut apart) = ends(raised)?;
        let (mut met, mut distance) = (Met::Raised, raised);
        if a.2 <= 0.0 && b.2 <= 0.0 {
            if a.2 + b.2 > -apart {
                return None;
            }
            (a, b, apart) = ends(flat)?;
            (met, distance) = (Met::Road, flat);
            if a.2 > 0.0 || b.2 > 0.0 || a.2 + b.2 > -apart {
                return None;
            }
        } else if a.2 <= 0.0 || b.2 <= 0.0 || a.2 + b.2 < apart {
            return None;
        }
        let run = [b.3[0] - a.3[0], b.3[1] - a.3[1]];
        let scale = 1.0 / (run[0] * run[0] + run[1] * run[1]).max(1e-9);
        let share = lanes(|i| {
            let x = self.view.origin[0] + distance[i] * rays[0][i] - a.3[0];
            let y = self.view.origin[1] + distance[i] * rays[1][i] - a.3[1];
            (x * run[0] + y * run[1]) * scale
        });
        let mut all = [met; LANES];
        for i in 0..LANES {
            if distance[i] >= limits[i] {
                all[i] = Met::Nothing;
            }
        }
        Some(Meetings {
            met: all,
            distance: *distance,
            places: Places {
                s: lanes(|i| a.0[0] + share[i] * (b.0[0] - a.0[0])),
                d: lanes(|i| a.0[1] + share[i] * (b.0[1] - a.0[1])),
                edge: lanes(|i| a.2 + share[i] * (b.2 - a.2)),
            },
            turn: a.1,
            typical: LANES / 2,
        })
    }

    /// Every ray on its own.
    fn each(&self, rays: &[Lanes; 3], limits: &Lanes, raised: &Lanes, flat: &Lanes) -> Meetings {
        let mut all = Meetings {
            met: [Met::Nothing; LANES],
            distance: *raised,
            places: Places {
                s: [0.0; LANES],
                d: [0.0; LANES],
                edge: [0.0; LANES],
            },
            turn: [1.0, 0.0],
            typical: LANES,
        };
        for i in 0..LANES {
            if raised[i] >= limits[i] {
                continue;
            }
            let (met, distance, located) = self.follow(ray(rays, i), raised[i], flat[i]);
            if distance >= limits[i] {
                continue;
            }
            (all.met[i], all.distance[i]) = (met, distance);
            if let Some((place, turn, edge, _)) = located {
                (all.places.s[i], all.places.d[i], all.places.edge[i]) = (place[0], place[1], edge);
                if all.typical == LANES || i <= LANES / 2 {
                    (all.typical, all.turn) = (i, turn);
                }
            }
        }
        // Rays without road coordinates take part in no drawing; they must only not stray far.
        let typical = all.typical.min(LANES - 1);
        for i in 0..LANES {
            if matches!(all.met[i], Met::Nothing | Met::Beyond) {
                all.places.s[i] = all.places.s[typical];
                all.places.d[i] = all.places.d[typical];
                all.places.edge[i] = all.places.edge[typical];
            }
        }
        all
    }

    fn follow(&self, ray: [f32; 3], raised: f32, flat: f32) -> (Met, f32, Option<Located>) {
        let Some(upper) = self.at(ray, raised) else {
            return (Met::Beyond, raised, None);
        };
        if upper.2 > 0.0 {
            return (Met::Raised, raised, Some(upper));
        }
        let Some(lower) = self.at(ray, flat) else {
            return (Met::Beyond, raised, None);
        };
        if lower.2 <= 0.0 {
            return (Met::Road, flat, Some(lower));
        }
        // Between the planes the ray crosses the kerb's face, about where its edge distance passes zero.
        let f = upper.2 / (upper.2 - lower.2);
        (Met::Face, raised + f * (flat - raised), Some(lower))
    }
}

impl Meetings {
    /// Radiance of the ground; `hidden` is the share of sky light and of sunlight that something above takes, in 255ths.
    pub(super) fn shade(
        &self,
        world: &World,
        rays: &[Lanes; 3],
        shutter: &Shutter,
        hidden: &[[u8; 2]; LANES],
    ) -> Colours {
        let style = &world.style;
        let light = style.sky_light_rgb[1] + 0.6 * style.sun_rgb[1];
        let mut rgb = style.beyond_rgb.map(|c| [c * light; LANES]);
        if self.typical == LANES {
            return rgb;
        }
        let foot = self.footprint(ray(rays, self.typical), shutter);
        let open = lanes(|i| 1.0 - f32::from(hidden[i][0]) * (1.0 / 255.0));
        let mut sun = [0.0; LANES];
        if style.sun_rgb[1] > 0.0 {
            sun = world.shadow.sunlight(&world.textures, &self.places, foot);
            sun = lanes(|i| sun[i] * (1.0 - f32::from(hidden[i][1]) * (1.0 / 255.0)) * style.sun[2]);
        }
        let mut light_up = |kind: Met, drawn: &Colours| {
            for (k, (channel, bare)) in rgb.iter_mut().zip(drawn).enumerate() {
                for i in 0..LANES {
                    let lit = bare[i] * (open[i] * style.sky_light_rgb[k] + sun[i] * style.sun_rgb[k]);
                    channel[i] = if self.met[i] == kind { lit } else { channel[i] };
                }
            }
        };
        if self.met.contains(&Met::Road) {
            let road = world.ground.road(style, &world.textures, &self.places, foot);
            light_up(Met::Road, &road);
        }
        if self.met.contains(&Met::Raised) {
            let verge = world.ground.verge(style, &world.textures, &self.places, foot);
            light_up(Met::Raised, &verge);
        }
        if self.met.contains(&Met::Face) {
            light_up(Met::Face, &style.kerb_rgb.map(|c| [0.6 * c; LANES]));
        }
        rgb
    }

    /// What a pixel covers, where the typical ray of the span meets the ground.
    fn footprint(&self, ray: [f32; 3], shutter: &Shutter) -> Footprint {
        let across = self.distance[self.typical] * shutter.pixel_rad;
        let along = across / (-ray[2]).max(0.01);
        let flat = 1.0 / (ray[0] * ray[0] + ray[1] * ray[1]).sqrt().max(1e-6);
        let [sx, sy] = self.turn;
        let ahead = ((ray[0] * sx + ray[1] * sy) * flat).abs().min(1.0);
        let aside = ((ray[0] * sy - ray[1] * sx) * flat).abs().min(1.0);
        Footprint {
            along_m: ahead * along + aside * across + shutter.blur_m,
            across_m: aside * along + ahead * across,
        }
    }
}
