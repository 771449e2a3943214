//! Ranges of the stages' own tables, so that no value the core would stumble over gets that far.

use super::{Config, Invalid, within};

impl Config {
    pub(super) fn check_stages(&self) -> Result<(), Invalid> {
        #[expect(clippy::cast_precision_loss, reason = "a number of tracks")]
        let tracks = self.track.wanted_tracks as f64;
        within("track.wanted_tracks", tracks, 50.0..=800.0, "tracks")?;
        within(
            "track.initial_speed_mps",
            self.track.initial_speed_mps,
            0.0..=80.0,
            "m/s",
        )?;
        self.check_belief()?;
        self.check_crf()?;
        let grid = &self.grid;
        for (key, value, range, unit) in [
            ("grid.cell_m", grid.cell_m, 0.05..=2.0, "metres"),
            ("grid.ahead_m", grid.ahead_m, 5.0..=200.0, "metres"),
            ("grid.side_m", grid.side_m, 2.0..=100.0, "metres"),
            ("grid.free_evidence", grid.free_evidence, 0.1..=10.0, "log-odds"),
            (
                "grid.occupied_evidence",
                grid.occupied_evidence,
                0.1..=10.0,
                "log-odds",
            ),
            ("grid.limit", grid.limit, 0.5..=10.0, "log-odds"),
            ("grid.unknown_below", grid.unknown_below, 0.0..=4.0, "log-odds"),
            ("grid.max_age_s", grid.max_age_s, 0.1..=25.0, "seconds"),
        ] {
            within(key, f64::from(value), range, unit)?;
        }
        Ok(())
    }

    fn check_belief(&self) -> Result<(), Invalid> {
        let belief = &self.priors.belief;
        for (key, value, range, unit) in [
            (
                "priors.max_range_m",
                self.priors.max_range_m,
                5.0..=500.0,
                "metres",
            ),
            ("priors.belief.cell_m", belief.cell_m, 0.05..=2.0, "metres"),
            ("priors.belief.ahead_m", belief.ahead_m, 5.0..=200.0, "metres"),
            ("priors.belief.side_m", belief.side_m, 2.0..=50.0, "metres"),
            (
                "priors.belief.plane_log_odds",
                belief.plane_log_odds,
                -5.0..=5.0,
                "log-odds",
            ),
            (
                "priors.belief.blocked_log_odds",
                belief.blocked_log_odds,
                -10.0..=0.0,
                "log-odds",
            ),
            (
                "priors.belief.path_log_odds",
                belief.path_log_odds,
                0.0..=10.0,
                "log-odds",
            ),
            (
                "priors.belief.lateral_log_odds",
                belief.lateral_log_odds,
                -10.0..=0.0,
                "log-odds",
            ),
            (
                "priors.belief.witness_against",
                belief.witness_against,
                -10.0..=0.0,
                "log-odds",
            ),
            (
                "priors.belief.witness_for",
                belief.witness_for,
                0.0..=10.0,
                "log-odds",
            ),
        ] {
            within(key, f64::from(value), range, unit)?;
        }
        Ok(())
    }

    fn check_crf(&self) -> Result<(), Invalid> {
        let crf = &self.crf;
        for (key, value, range) in [
            ("crf.omega_1", crf.omega_1, 0.0..=100.0),
            ("crf.omega_2", crf.omega_2, 0.0..=100.0),
            ("crf.omega_3", crf.omega_3, 0.0..=100.0),
            ("crf.network", crf.network, 0.0..=100.0),
            ("crf.network_clip", crf.network_clip, 0.0..=20.0),
            ("crf.network_temperature", crf.network_temperature, 0.05..=20.0),
            ("crf.belief", crf.belief, 0.0..=100.0),
            ("crf.belief_previous", crf.belief_previous, 0.0..=100.0),
            ("crf.belief_clip", crf.belief_clip, 0.0..=20.0),
            ("crf.smoothness", crf.smoothness, 0.0..=100.0),
            ("crf.smoothness_floor", crf.smoothness_floor, 0.0..=1.0),
            ("crf.contrast_sigma", crf.contrast_sigma, 0.0..=255.0),
            ("crf.contrast_floor", crf.contrast_floor, 0.0..=1.0),
        ] {
            within(key, f64::from(value), range, "energy units")?;
        }
        Ok(())
    }
}
