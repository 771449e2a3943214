//! The soft dark patches under vehicles and people.
//!
//! In: the parts of one object. Out: patches that hide light from the ground around its base.
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "shares are in 255ths"
)]

use super::raster::View;
use super::shape::Part;
use super::truth::Label;

/// A soft dark patch under something on the road.
#[derive(Clone, Copy, Debug)]
pub(super) struct Decal {
    pub(super) base: [f32; 3],
    pub(super) turn: [f32; 2],
    pub(super) half: [f32; 2],
    pub(super) soft: f32,
    /// Share of sky light hidden, share of sunlight hidden.
    hides: [f32; 2],
}

/// The dark patches of one object.
pub(super) fn decals(parts: &[Part], moves: bool, sun: [f32; 3], out: &mut Vec<Decal>) {
    let Some(first) = parts.first() else { return };
    let living = first.label == Label::Living as u8;
    if !living && first.label != Label::Vehicle as u8 {
        return;
    }
    let turn = [first.sin, first.cos];
    let floor = parts.iter().map(|p| p.base[2]).fold(f32::MAX, f32::min);
    let floor = if floor < 0.3 { floor } else { 0.0 };
    let ground = [first.base[0], first.base[1], floor];
    out.push(Decal {
        base: ground,
        turn,
        half: first.half,
        soft: if living { 0.15 } else { 0.3 },
        hides: [0.75, 0.9],
    });
    if moves {
        let away = 0.55 / sun[2];
        let base = [ground[0] - sun[0] * away, ground[1] - sun[1] * away, floor];
        out.push(Decal {
            base,
            turn,
            half: first.half,
            soft: 0.2,
            hides: [0.0, 1.0],
        });
    }
}

impl Decal {
    #[inline]
    pub(super) fn darken(&self, view: &View, ray: [f32; 3], hidden: &mut [u8; 2]) {
        if ray[2] > -1e-4 {
            return;
        }
        let distance = (self.base[2] - view.origin[2]) / ray[2];
        let dx = view.origin[0] + distance * ray[0] - self.base[0];
        let dy = view.origin[1] + distance * ray[1] - self.base[1];
        let [sin, cos] = self.turn;
        let along = (dx * cos + dy * sin).abs();
        let aside = (dy * cos - dx * sin).abs();
        let inside = |at: f32, half: f32| ((half + self.soft - at) / (2.0 * self.soft)).clamp(0.0, 1.0);
        let share = inside(along, self.half[0]) * inside(aside, self.half[1]);
        for (h, hides) in hidden.iter_mut().zip(self.hides) {
            *h = (*h).max((255.0 * share * hides) as u8);
        }
    }
}
