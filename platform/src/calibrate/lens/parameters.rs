//! The parameters of a lens as a row of numbers.

use freespace::frame::{BrownConrady, KannalaBrandt, Lens};

/// Parameters of either model at most.
pub(super) const MOST_PARAMETERS: usize = 9;

/// Parameters in the order in which they are freed.
pub(super) fn parameters_of(lens: &Lens) -> Vec<(&'static str, f64)> {
    match lens {
        Lens::BrownConrady(l) => vec![
            ("fx", l.fx),
            ("fy", l.fy),
            ("cx", l.cx),
            ("cy", l.cy),
            ("k1", l.k[0]),
            ("k2", l.k[1]),
            ("p1", l.p[0]),
            ("p2", l.p[1]),
            ("k3", l.k[2]),
        ],
        Lens::KannalaBrandt(l) => vec![
            ("fx", l.fx),
            ("fy", l.fy),
            ("cx", l.cx),
            ("cy", l.cy),
            ("k1", l.k[0]),
            ("k2", l.k[1]),
            ("k3", l.k[2]),
            ("k4", l.k[3]),
        ],
    }
}

/// The lens with `change` added to its first parameters.
pub(super) fn changed(lens: &Lens, change: impl Fn(usize) -> f64) -> Lens {
    match *lens {
        Lens::BrownConrady(l) => Lens::BrownConrady(BrownConrady {
            fx: l.fx + change(0),
            fy: l.fy + change(1),
            cx: l.cx + change(2),
            cy: l.cy + change(3),
            k: [l.k[0] + change(4), l.k[1] + change(5), l.k[2] + change(8)],
            p: [l.p[0] + change(6), l.p[1] + change(7)],
        }),
        Lens::KannalaBrandt(l) => Lens::KannalaBrandt(KannalaBrandt {
            fx: l.fx + change(0),
            fy: l.fy + change(1),
            cx: l.cx + change(2),
            cy: l.cy + change(3),
            k: std::array::from_fn(|i| l.k[i] + change(4 + i)),
        }),
    }
}
