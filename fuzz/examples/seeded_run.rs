//! `seeded-run [--cases N] [--seed N] [--first N] [TARGET...]`: runs mutated seeds on all targets,
//! or on those given, without coverage.
//!
//! Case `n` of a target depends only on the seed, the target and `n`, so `--first n --cases 1`
//! repeats a finding.

use std::collections::HashSet;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

use psfield_fuzz::{TARGETS, Target, mutate};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

struct Options {
    cases: u64,
    seed: u64,
    first: u64,
    names: HashSet<String>,
}

fn options() -> Result<Options, String> {
    let mut options = Options {
        cases: 2000,
        seed: 1,
        first: 0,
        names: HashSet::new(),
    };
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let place = match word.as_str() {
            "--cases" => &mut options.cases,
            "--seed" => &mut options.seed,
            "--first" => &mut options.first,
            name if TARGETS.iter().any(|target| target.name == name) => {
                options.names.insert(word);
                continue;
            }
            _ => return Err(format!("{word} is neither an option nor a target")),
        };
        let number = words.next().and_then(|text| text.parse().ok());
        *place = number.ok_or_else(|| format!("{word} needs an integer"))?;
    }
    Ok(options)
}

fn main() -> ExitCode {
    let options = match options() {
        Ok(options) => options,
        Err(problem) => {
            eprintln!("seeded-run: {problem}");
            return ExitCode::from(2);
        }
    };
    let mut sound = true;
    for (number, target) in TARGETS.iter().enumerate() {
        if options.names.is_empty() || options.names.contains(target.name) {
            sound &= run(target, number as u64, &options);
        }
    }
    if sound {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    }
}

/// Runs the cases of a target. Returns false at the first finding.
fn run(target: &Target, number: u64, options: &Options) -> bool {
    let start = Instant::now();
    let seeds = (target.seeds)();
    for (which, seed) in seeds.iter().enumerate() {
        assert!(
            (target.run)(seed) > 0,
            "{}: seed {which} cannot be read",
            target.name
        );
    }
    let artifact = artifact(target.name);
    let mut read = 0_u64;
    let (mut slowest, mut slowest_case) = (0.0, 0);
    for case in options.first..options.first + options.cases {
        let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
        rng.set_stream(number << 40 | case);
        let mut data = seeds[rng.random_range(0..seeds.len())].clone();
        mutate(&mut data, &mut rng);
        // The file stays there if the process dies.
        std::fs::write(&artifact, &data).expect("the folder of findings can be written to");
        let clock = Instant::now();
        let outcome = catch_unwind(AssertUnwindSafe(|| (target.run)(&data)));
        let seconds = clock.elapsed().as_secs_f64();
        if seconds > slowest {
            (slowest, slowest_case) = (seconds, case);
        }
        match outcome {
            Ok(ways) => read += u64::from(ways > 0),
            Err(_) => {
                eprintln!(
                    "{}: case {case} of seed {} failed, its file is {}",
                    target.name,
                    options.seed,
                    artifact.display()
                );
                return false;
            }
        }
    }
    std::fs::remove_file(&artifact).ok();
    println!(
        "{:<11}{:>7} cases, {:>3} % of them readable, {:>6.1} s, slowest case {slowest_case}: {slowest:.3} s",
        target.name,
        options.cases,
        100 * read / options.cases.max(1),
        start.elapsed().as_secs_f64()
    );
    true
}

/// The path of the file for the current case.
fn artifact(target: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("artifacts")
        .join(target);
    std::fs::create_dir_all(&folder).expect("the folder of findings can be created");
    folder.join("seeded-run")
}
