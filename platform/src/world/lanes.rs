//! Eight pixels side by side in a row, worked on together.
//!
//! In: a value for each pixel. Out: arrays that the compiler keeps in vector registers.

/// Pixels of a span.
pub(super) const LANES: usize = 8;

/// A value for each pixel of a span.
pub(super) type Lanes = [f32; LANES];

/// A colour for each pixel of a span, red first.
pub(super) type Colours = [Lanes; 3];

/// Evaluates `value` at every pixel.
#[inline(always)]
pub(super) fn lanes(mut value: impl FnMut(usize) -> f32) -> Lanes {
    let mut out = [0.0; LANES];
    for (i, lane) in out.iter_mut().enumerate() {
        *lane = value(i);
    }
    out
}

/// `rgb` times a factor for each pixel.
#[inline(always)]
pub(super) fn coloured(rgb: [f32; 3], by: &Lanes) -> Colours {
    [
        lanes(|i| rgb[0] * by[i]),
        lanes(|i| rgb[1] * by[i]),
        lanes(|i| rgb[2] * by[i]),
    ]
}

/// Least and greatest.
#[inline]
pub(super) fn range(of: &Lanes) -> (f32, f32) {
    of.iter()
        .fold((f32::MAX, f32::MIN), |(low, high), &x| (low.min(x), high.max(x)))
}

/// Sets the colour of one pixel of a span.
#[inline(always)]
pub(super) fn put(colours: &mut Colours, i: usize, rgb: [f32; 3]) {
    for (channel, value) in colours.iter_mut().zip(rgb) {
        channel[i] = value;
    }
}

/// The vector or colour of one pixel of a span.
#[inline(always)]
pub(super) fn ray(rays: &[Lanes; 3], i: usize) -> [f32; 3] {
    [rays[0][i], rays[1][i], rays[2][i]]
}
