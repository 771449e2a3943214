//! The shipped job descriptions say what the program understands.

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use clap::Parser as _;
use freespace_platform::cli::{Cli, Command as Subcommand, EvalCommand};
use saphyr::{LoadableYamlNode as _, Yaml};

use crate::inputs::fleet;
use crate::{folder, said, text};

fn shipped(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../config").join(name)
}

fn words(list: &Yaml<'_>) -> Vec<String> {
    let words = list.as_sequence().unwrap().iter();
    words.map(|word| word.as_str().unwrap().to_owned()).collect()
}

/// The one container's command, as the kubelet starts it for shard 3.
fn command(container: &Yaml<'_>) -> Vec<String> {
    let all = [words(&container["command"]), words(&container["args"])].concat();
    all.into_iter()
        .map(|word| word.replace("$(JOB_COMPLETION_INDEX)", "3"))
        .collect()
}

#[test]
fn the_kubernetes_jobs_start_real_commands_without_privileges() {
    let yaml = fs::read_to_string(shipped("fleet-job.yaml")).unwrap();
    let jobs = Yaml::load_from_str(&yaml).unwrap();
    assert_eq!(jobs.len(), 2);
    let mut parsed = Vec::new();
    for job in &jobs {
        assert_eq!(job["kind"].as_str(), Some("Job"));
        let pod = &job["spec"]["template"]["spec"];
        assert_eq!(pod["securityContext"]["runAsNonRoot"].as_bool(), Some(true));
        assert_eq!(pod["automountServiceAccountToken"].as_bool(), Some(false));
        let container = &pod["containers"].as_sequence().unwrap()[0];
        let confined = &container["securityContext"];
        assert_eq!(confined["allowPrivilegeEscalation"].as_bool(), Some(false));
        assert_eq!(confined["readOnlyRootFilesystem"].as_bool(), Some(true));
        assert_eq!(words(&confined["capabilities"]["drop"]), ["ALL"]);
        assert!(container["resources"]["limits"]["memory"].as_str().is_some());
        parsed.push(Cli::try_parse_from(command(container)).unwrap().command);
    }
    let [
        Subcommand::Eval(EvalCommand::Drives(drives)),
        Subcommand::Eval(EvalCommand::Merge(merge)),
    ] = &parsed[..]
    else {
        panic!("{parsed:?}");
    };
    let completions = jobs[0]["spec"]["completions"].as_integer().unwrap();
    assert_eq!(
        (drives.shard.index, i64::try_from(drives.shard.of).unwrap()),
        (3, completions)
    );
    assert_eq!(drives.out.parent(), Some(merge.parts[0].as_path()));
}

/// Runs an array's tasks at once, as Slurm would on as many nodes, and waits for them.
const SBATCH: &str = r#"#!/usr/bin/env bash
set -euo pipefail
last=
for word in "$@"; do
    case $word in
    --array=0-*) last=${word#--array=0-} ;;
    --*) ;;
    *) command+=("$word") ;;
    esac
done
if [ -z "$last" ]; then
    bash "${command[@]}"
else
    for task in $(seq 0 "$last"); do
        SLURM_ARRAY_TASK_ID=$task bash "${command[@]}" >&2 &
        tasks+=($!)
    done
    for task in "${tasks[@]}"; do wait "$task"; done
    echo '77;cluster'
fi
"#;

#[test]
fn the_slurm_file_evaluates_all_shards_and_joins_them() {
    let script = shipped("fleet.slurm");
    let syntax = Command::new("bash").arg("-n").arg(&script).output().unwrap();
    said(&syntax);
    let results = folder("slurm");
    let sbatch = results.join("sbatch");
    fs::write(&sbatch, SBATCH).unwrap();
    fs::set_permissions(&sbatch, fs::Permissions::from_mode(0o755)).unwrap();
    let path = format!("{}:{}", results.display(), std::env::var("PATH").unwrap());
    let output = Command::new("bash")
        .arg(&script)
        .env("PATH", path)
        .env("FREESPACE", env!("CARGO_BIN_EXE_freespace"))
        .env("DRIVES", fleet())
        .env("RESULTS", &results)
        .env("SHARDS", "3")
        .output()
        .unwrap();
    let table = said(&output);
    assert!(table.contains("drives                3 of 3"), "{table}");
    assert!(results.join("parts-3/2.json").is_file(), "{}", text(&results));
    assert!(results.join("fleet.json").is_file());
}
