//! Hash-based noise and the seeded generator: the world's only sources of chance.
//!
//! In: seeds and lattice coordinates. Out: numbers that depend on nothing else, so that a seed names a world for ever.
//! Source: splitmix64 (Steele et al., 2014); value noise (Perlin and Hoffert, 1989).

/// Scrambles two words into one.
pub(super) const fn hash(a: u32, b: u32) -> u32 {
    let mut x = a.wrapping_mul(0x9e37_79b1) ^ b.wrapping_mul(0x85eb_ca77).rotate_left(13);
    x ^= x >> 15;
    x = x.wrapping_mul(0x2c1b_3c6d);
    x ^= x >> 12;
    x = x.wrapping_mul(0x297a_2d39);
    x ^ (x >> 15)
}

/// A number in `[0, 1)` from a hash.
#[expect(clippy::cast_precision_loss, reason = "24 bits fit an f32")]
pub(super) fn unit(hash: u32) -> f32 {
    (hash >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// A seeded sequence of numbers.
#[derive(Clone, Debug)]
pub(super) struct Seeded(u64);

impl Seeded {
    /// The sequence of `seed` for one `purpose`; purposes do not disturb each other.
    pub(super) fn new(seed: u64, purpose: u64) -> Self {
        let mut sequence = Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ (purpose << 40));
        sequence.next();
        sequence
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// 32 random bits.
    pub(super) fn word(&mut self) -> u32 {
        (self.next() >> 32) as u32
    }

    /// Uniform in `[low, high)`.
    pub(super) fn range(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * unit(self.word())
    }

    /// True with probability `p`.
    pub(super) fn chance(&mut self, p: f32) -> bool {
        unit(self.word()) < p
    }

    /// One of `items`.
    pub(super) fn pick<T: Copy>(&mut self, items: &[T]) -> T {
        items[self.word() as usize % items.len()]
    }
}

/// Rounds towards minus infinity without a library call.
#[expect(clippy::cast_possible_truncation, reason = "coordinates are far below 2^31")]
pub(super) fn floor(x: f32) -> i32 {
    let whole = x as i32;
    let back = whole as f32;
    whole - i32::from(x < back)
}

/// Value noise of one dimension in `[-1, 1]`, cubic between whole numbers.
#[expect(
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "lattice indices wrap into the hash"
)]
pub(super) fn wave(seed: u32, x: f32) -> f32 {
    let cell = floor(x);
    let f = x - cell as f32;
    let at = |i: i32| 2.0 * unit(hash(seed, (cell + i) as u32)) - 1.0;
    let (a, b) = (at(0), at(1));
    a + (b - a) * f * f * (3.0 - 2.0 * f)
}

/// 0 below `low`, 1 above `high`, smooth between.
pub(super) fn smoothstep(low: f32, high: f32, x: f32) -> f32 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}
