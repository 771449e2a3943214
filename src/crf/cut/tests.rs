#![allow(clippy::unwrap_used, reason = "tests")]
extern crate std;

use std::fs;
use std::path::PathBuf;
use std::vec::Vec;
use std::{format, println};

use proptest::prelude::*;

use super::{CutState, GridCut, GridProblem};

/// A problem that owns its capacities.
#[derive(Debug)]
struct Instance {
    width: usize,
    height: usize,
    capacities: [Vec<i32>; 4],
}

impl Instance {
    fn problem(&self) -> GridProblem<'_> {
        let [source, sink, right, down] = &self.capacities;
        GridProblem {
            width: self.width,
            height: self.height,
            source,
            sink,
            right,
            down,
        }
    }

    fn parse(bytes: &[u8]) -> Self {
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
        let (width, height) = (word(0), word(4));
        let plane = |k: usize| {
            let start = 8 + 2 * k * width * height;
            let plane = &bytes[start..start + 2 * width * height];
            plane
                .chunks_exact(2)
                .map(|b| i32::from(u16::from_le_bytes([b[0], b[1]])))
                .collect()
        };
        Self {
            width,
            height,
            capacities: [plane(0), plane(1), plane(2), plane(3)],
        }
    }

    /// The same problem over 2x2 pixels, capacities summed.
    fn half(&self) -> Self {
        let (width, height) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let mut capacities = [(); 4].map(|()| std::vec![0; width * height]);
        let [source, sink, right, down] = &mut capacities;
        super::halve(
            &self.problem(),
            &mut super::Halved {
                source,
                sink,
                right,
                down,
            },
        );
        Self {
            width,
            height,
            capacities,
        }
    }

    fn lowest_energy_of_all_labellings(&self) -> i64 {
        let count = self.width * self.height;
        let problem = self.problem();
        (0..1_u32 << count)
            .map(|bits| problem.energy(&(0..count).map(|p| (bits >> p & 1) as u8).collect::<Vec<_>>()))
            .min()
            .unwrap()
    }
}

fn small_instances() -> impl Strategy<Value = Instance> {
    (1..5_usize, 1..4_usize).prop_flat_map(|(width, height)| {
        let plane = |top: i32| prop::collection::vec(prop_oneof![Just(0), 0..top], width * height);
        (plane(40), plane(40), plane(30), plane(30)).prop_map(move |(source, sink, right, down)| Instance {
            width,
            height,
            capacities: [source, sink, right, down],
        })
    })
}

fn larger_instances() -> impl Strategy<Value = Instance> {
    (20..40_usize, 20..40_usize).prop_flat_map(|(width, height)| {
        let sparse = || prop::collection::vec(prop_oneof![9 => Just(0), 1 => 0..400], width * height);
        let plane = || prop::collection::vec(0..30, width * height);
        (sparse(), sparse(), plane(), plane()).prop_map(move |(source, sink, right, down)| Instance {
            width,
            height,
            capacities: [source, sink, right, down],
        })
    })
}

fn solved(instance: &Instance) -> GridCut {
    let mut cut = GridCut::new(instance.width, instance.height);
    cut.start(&instance.problem());
    while cut.advance(1_000_000) == CutState::Running {}
    cut
}

proptest! {
    #[test]
    fn finds_the_lowest_energy_of_all_labellings(instance in small_instances()) {
        let cut = solved(&instance);
        let lowest = instance.lowest_energy_of_all_labellings();
        prop_assert_eq!(cut.bounds(), (lowest, lowest));
        prop_assert_eq!(instance.problem().energy(cut.labels()), lowest);
    }

    #[test]
    fn bounds_close_in_while_it_works(instance in larger_instances(), quantum in 1..500_u32) {
        let lowest = solved(&instance).bounds().1;
        let problem = instance.problem();
        let mut cut = GridCut::new(instance.width, instance.height);
        cut.start(&problem);
        let mut last = cut.bounds();
        loop {
            let state = cut.advance(quantum);
            let (lower, upper) = cut.bounds();
            prop_assert_eq!(problem.energy(cut.labels()), upper);
            prop_assert!(last.0 <= lower && lower <= lowest && lowest <= upper && upper <= last.1);
            last = (lower, upper);
            if state == CutState::Done {
                break;
            }
        }
        prop_assert_eq!(last, (lowest, lowest));
    }

    #[test]
    fn the_flow_of_the_half_changes_nothing_but_the_way(instance in larger_instances()) {
        let lowest = solved(&instance).bounds().1;
        let half = solved(&instance.half());
        let problem = instance.problem();
        let mut cut = GridCut::new(instance.width, instance.height);
        cut.start_from_half(&problem, &half);
        let (lower, upper) = cut.bounds();
        prop_assert!(lower <= lowest && lowest <= upper);
        while cut.advance(1_000_000) == CutState::Running {}
        prop_assert_eq!(cut.bounds(), (lowest, lowest));
        prop_assert_eq!(problem.energy(cut.labels()), lowest);
    }
}

#[test]
fn a_solver_is_reusable_after_an_abort() {
    let instance = Instance {
        width: 30,
        height: 20,
        capacities: [0, 7, 3, 5].map(|seed| (0..600).map(|p| p * (seed + 13) * 7919 % 101).collect()),
    };
    let mut cut = GridCut::new(30, 20);
    cut.start(&instance.problem());
    assert_eq!(cut.advance(50), CutState::Running);
    cut.start(&instance.problem());
    while cut.advance(100) == CutState::Running {}
    assert_eq!(cut.bounds(), solved(&instance).bounds());
}

/// The folder of reference problems, beside the data sets.
fn reference_folder() -> PathBuf {
    let data =
        std::env::var_os("FREESPACE_DATA").map_or_else(|| PathBuf::from("../shared/data"), PathBuf::from);
    data.join("../maxflow")
}

/// Solves the reference problems that `is_wanted` names; flow and energy must be those of the table.
fn check_reference_problems(test: &str, is_wanted: impl Fn(&str) -> bool) {
    let folder = reference_folder();
    let Ok(table) = fs::read_to_string(folder.join("flows.csv")) else {
        println!(
            "SKIPPED crf::cut {test}: no reference problems in {}",
            folder.display()
        );
        return;
    };
    for line in table.lines().skip(1).filter(|line| is_wanted(line)) {
        let fields: Vec<&str> = line.split(',').collect();
        let (name, flow) = (fields[0], fields[3].parse::<i64>().unwrap());
        let Ok(bytes) = fs::read(folder.join(format!("{name}.mfg16"))) else {
            println!("SKIPPED crf::cut {test}: no {name}");
            continue;
        };
        let instance = Instance::parse(&bytes);
        let cut = solved(&instance);
        assert_eq!(cut.bounds(), (flow, flow), "{name}");
        assert_eq!(instance.problem().energy(cut.labels()), flow, "{name}");
    }
}

#[test]
fn flow_equals_flows_csv() {
    check_reference_problems("flow_equals_flows_csv", |line| {
        line.contains(",480,") && !line.starts_with("adverse")
    });
}

#[test]
#[ignore = "the large and the adverse problems take up to a minute"]
fn flow_equals_flows_csv_everywhere() {
    check_reference_problems("flow_equals_flows_csv_everywhere", |_| true);
}
