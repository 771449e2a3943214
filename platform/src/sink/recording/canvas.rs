//! An RGB picture to draw on: pixels, rectangles, lines, text.
//!
//! Invariant: what lies outside the picture is left out. Cost: that of the pixels touched; a line's steps are capped by the
//! picture's size. The pixels may be a buffer that is used again: [`Canvas::filled`] takes one and gives it its size.
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "pixel arithmetic: coordinates are bounded by the picture"
)]

use super::font;

/// Red, green, blue.
pub(super) type Colour = [u8; 3];

/// `pixel` with `eighths` of `tint` in it.
pub(super) fn mixed(pixel: Colour, tint: Colour, eighths: u16) -> Colour {
    std::array::from_fn(|c| ((u16::from(pixel[c]) * (8 - eighths) + u16::from(tint[c]) * eighths) / 8) as u8)
}

/// An RGB picture.
#[derive(Debug)]
pub(super) struct Canvas<'a> {
    pub(super) width: usize,
    pub(super) height: usize,
    /// `[height, width, 3] u8`.
    pub(super) pixels: &'a mut Vec<u8>,
}

/// Which end of a text its position is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Anchor {
    Left,
    Middle,
    Right,
}

impl<'a> Canvas<'a> {
    /// A picture of one colour in `pixels`, which is made to fit.
    pub(super) fn filled(pixels: &'a mut Vec<u8>, width: usize, height: usize, colour: Colour) -> Self {
        pixels.clear();
        pixels.resize(3 * width * height, 0);
        for pixel in pixels.chunks_exact_mut(3) {
            pixel.copy_from_slice(&colour);
        }
        Self {
            width,
            height,
            pixels,
        }
    }

    /// Mixes a colour into a pixel.
    pub(super) fn set(&mut self, x: f64, y: f64, colour: Colour, eighths: u16) {
        if x < 0.0 || y < 0.0 || x >= self.width as f64 || y >= self.height as f64 {
            return;
        }
        let i = 3 * (y as usize * self.width + x as usize);
        let pixel = std::array::from_fn(|c| self.pixels[i + c]);
        self.pixels[i..i + 3].copy_from_slice(&mixed(pixel, colour, eighths));
    }

    /// A rectangle from `(x0, y0)` up to but without `(x1, y1)`.
    pub(super) fn rectangle(&mut self, from: (f64, f64), to: (f64, f64), colour: Colour, eighths: u16) {
        let within = |value: f64, end: usize| value.round().clamp(0.0, end as f64) as usize;
        let (x0, x1) = (within(from.0, self.width), within(to.0, self.width));
        for y in within(from.1, self.height)..within(to.1, self.height) {
            for x in x0..x1 {
                self.set(x as f64, y as f64, colour, eighths);
            }
        }
    }

    /// A line of one pixel.
    pub(super) fn line(&mut self, from: (f32, f32), to: (f32, f32), colour: Colour) {
        let (x0, y0) = (f64::from(from.0), f64::from(from.1));
        let (dx, dy) = (f64::from(to.0) - x0, f64::from(to.1) - y0);
        if !(dx.is_finite() && dy.is_finite() && x0.is_finite() && y0.is_finite()) {
            return;
        }
        let cap = 4.0 * (self.width + self.height) as f64;
        let steps = dx.abs().max(dy.abs()).clamp(1.0, cap).ceil();
        for step in 0..=steps as usize {
            let part = step as f64 / steps;
            self.set((x0 + part * dx).round(), (y0 + part * dy).round(), colour, 7);
        }
    }

    /// A text whose letters stand on `y`, each of their pixels `size` pixels wide and high.
    pub(super) fn text(&mut self, at: (f64, f64), anchor: Anchor, size: usize, text: &str, colour: Colour) {
        let size = size as f64;
        let shift = match anchor {
            Anchor::Left => 0.0,
            Anchor::Middle => 0.5,
            Anchor::Right => 1.0,
        };
        let left = (at.0 - shift * text_width(text, size)).round();
        let top = at.1.round() - font::ABOVE as f64 * size;
        for (letter, character) in text.chars().enumerate() {
            let left = left + letter as f64 * font::ADVANCE as f64 * size;
            for (row, bits) in font::glyph(character).into_iter().enumerate() {
                for column in (0..font::WIDTH).filter(|column| bits >> (font::WIDTH - 1 - column) & 1 == 1) {
                    let corner = (left + column as f64 * size, top + row as f64 * size);
                    self.rectangle(corner, (corner.0 + size, corner.1 + size), colour, 8);
                }
            }
        }
    }
}

/// Width of a text whose letters' pixels are `size` wide.
pub(super) fn text_width(text: &str, size: f64) -> f64 {
    let letters = text.chars().count() as f64;
    (letters * font::ADVANCE as f64 - (font::ADVANCE - font::WIDTH) as f64).max(0.0) * size
}
