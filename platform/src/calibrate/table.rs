//! Tables of the configuration, ready to be pasted.

use freespace::frame::Lens;
use freespace::space::Mount;

use crate::config::ImageSize;

/// `[camera.lens]` of a lens, and the size it belongs to where that is known.
#[must_use]
pub fn lens_table(lens: &Lens, size: Option<ImageSize>) -> String {
    let mut text = size.map_or_else(String::new, |size| {
        format!("[camera]\nwidth = {}\nheight = {}\n\n", size.width, size.height)
    });
    let list = |values: &[f64]| {
        let words: Vec<String> = values.iter().map(|value| number(*value, 8)).collect();
        words.join(", ")
    };
    let (model, [fx, fy, cx, cy], more) = match lens {
        Lens::BrownConrady(l) => (
            "brown_conrady",
            [l.fx, l.fy, l.cx, l.cy],
            format!("k = [{}]\np = [{}]\n", list(&l.k), list(&l.p)),
        ),
        Lens::KannalaBrandt(l) => (
            "kannala_brandt",
            [l.fx, l.fy, l.cx, l.cy],
            format!("k = [{}]\n", list(&l.k)),
        ),
    };
    text.push_str(&format!(
        "[camera.lens]\nmodel = \"{model}\"\nfx = {}\nfy = {}\ncx = {}\ncy = {}\n{more}",
        number(fx, 4),
        number(fy, 4),
        number(cx, 4),
        number(cy, 4)
    ));
    text
}

/// A number as TOML reads it, with a point.
fn number(value: f64, digits: usize) -> String {
    let text = format!("{value:.digits$}");
    let short = text.trim_end_matches('0');
    if short.ends_with('.') {
        format!("{short}0")
    } else {
        short.to_owned()
    }
}

/// `[camera.mount]` of a mount.
#[must_use]
pub fn mount_table(mount: &Mount) -> String {
    format!(
        "[camera.mount]\nheight_m = {}\nahead_m = {}\nleft_m = {}\npitch_rad = {}\nyaw_rad = {}\nroll_rad = {}\n",
        number(mount.height_m, 3),
        number(mount.ahead_m, 3),
        number(mount.left_m, 3),
        number(mount.pitch_rad, 4),
        number(mount.yaw_rad, 4),
        number(mount.roll_rad, 4)
    )
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use freespace::frame::{BrownConrady, KannalaBrandt};

    use super::*;

    /// What is printed can be pasted: the configuration takes it and gives the same lens.
    #[test]
    fn a_printed_table_is_read_back() {
        let size = ImageSize {
            width: 640,
            height: 480,
        };
        for lens in [
            Lens::BrownConrady(BrownConrady {
                fx: 520.25,
                fy: 515.5,
                cx: 330.0,
                cy: 235.0,
                k: [-0.28, 0.09, -0.012],
                p: [0.0008, -5e-4],
            }),
            Lens::KannalaBrandt(KannalaBrandt {
                fx: 285.0,
                fy: 286.0,
                cx: 316.5,
                cy: 243.0,
                k: [-0.02, 0.006, -0.003, 0.0],
            }),
        ] {
            let mount = Mount {
                height_m: 1.4,
                ahead_m: 1.6,
                left_m: 0.0,
                pitch_rad: 0.05,
                yaw_rad: 0.0,
                roll_rad: -0.01,
            };
            let text = lens_table(&lens, Some(size)).replace("\n\n", "\nframe_rate_hz = 30.0\n");
            let text = format!(
                "{text}{}[network]\nmanifest = \"road.toml\"\n",
                mount_table(&mount)
            );
            let config = crate::config::Config::parse(std::path::Path::new("car.toml"), &text).unwrap();
            let camera = config.camera_for(std::path::Path::new("."), 640, 480).unwrap();
            assert_eq!((camera.lens, camera.mount), (lens, mount));
        }
    }
}
