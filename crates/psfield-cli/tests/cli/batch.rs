//! `psfield batch`.

use psfield::psf_io::{Card, CardValue};
use serde_json::Value;

use crate::desk::{Desk, Run, assert_keys, samples};

/// Jobs with two PSFs, with and without stars, in both precisions, streamed, with a part of the
/// scene, and with a detector.
const NIGHT: &str = r#"
    [defaults]
    psf = "samples.fits"
    spot_check = 40

    [[job]]
    scene = "scene.fits"
    output = "plain.fits"

    [[job]]
    name = "stars alone"
    catalog = "stars.csv"
    columns = { x = "X_IMAGE", y = "Y_IMAGE", flux = "FLUX" }
    one-based = true
    shape = [61, 51]
    output = "stars.fits"

    [[job]]
    scene = "scene.fits"
    output = "double.fits"
    precision = "f64"
    tolerance = 1e-6

    [[job]]
    scene = "scene.fits"
    output = "streamed.fits"
    stream = true
    psf = "other.fits"

    [[job]]
    scene = "scene.fits"
    output = "part.fits"
    frame = [4, 3, 50, 40]
    anchor = "output"

    [[job]]
    scene = "scene.fits"
    output = "raw.fits"
    truth = "truth.fits"
    quality = "quality.fits"
    detector = "ccd.toml"
    seed = 7
    one-based = false
"#;

/// The options of the same jobs for single runs of `simulate`.
const BY_HAND: [(&str, &str); 6] = [
    ("plain", "scene.fits --psf samples.fits"),
    (
        "stars",
        "--psf samples.fits --catalog stars.csv --shape 61,51 --one-based --columns x=X_IMAGE,y=Y_IMAGE,flux=FLUX",
    ),
    (
        "double",
        "scene.fits --psf samples.fits --precision f64 --tolerance 1e-6",
    ),
    ("streamed", "scene.fits --psf other.fits --stream"),
    (
        "part",
        "scene.fits --psf samples.fits --frame 4,3,50,40 --anchor output",
    ),
    (
        "raw",
        "scene.fits --psf samples.fits --detector ccd.toml --seed 7",
    ),
];

fn night() -> Desk {
    let desk = Desk::new();
    desk.write_samples("other.fits", &samples(4, 1));
    desk.write("stars.csv", "X_IMAGE,Y_IMAGE,FLUX\n21,14,500\n40,31,200\n");
    desk.write(
        "ccd.toml",
        "photon_noise = true\nsky_e = 30.0\nread_noise_e = 3.0\nbits = 16\n",
    );
    desk.write("night.toml", NIGHT);
    desk
}

/// The lines of JSON on standard output.
fn lines(run: &Run) -> Vec<Value> {
    let parse = |line: &str| serde_json::from_str(line).unwrap_or_else(|e| panic!("{e} in {run:?}"));
    run.stdout.lines().map(parse).collect()
}

fn column<'a>(lines: &'a [Value], key: &str) -> Vec<&'a str> {
    lines.iter().map(|line| line[key].as_str().unwrap()).collect()
}

fn text(desk: &Desk, file: &str, keyword: &str) -> Option<String> {
    match desk.header(file).get(keyword).and_then(Card::value) {
        Some(CardValue::Text(text)) => Some(text),
        _ => None,
    }
}

#[test]
fn a_batch_gives_what_its_jobs_give_alone() {
    let desk = night();
    let run = desk.done("batch night.toml --log log.jsonl");
    let said = lines(&run);
    assert_eq!(column(&said, "status"), ["done"; 6]);
    let names = [
        "plain.fits",
        "stars alone",
        "double.fits",
        "streamed.fits",
        "part.fits",
        "raw.fits",
    ];
    assert_eq!(column(&said, "name"), names);
    for (k, line) in said.iter().enumerate() {
        assert_keys(line, &["output", "error", "seconds", "reused"]);
        assert_eq!(line["job"], k + 1);
        assert_keys(
            &line["report"],
            &["tiles", "seconds", "spot_check", "exposure", "rank"],
        );
    }
    assert_eq!(said[3]["report"]["streamed"], true);
    assert_eq!(String::from_utf8(desk.bytes("log.jsonl")).unwrap(), run.stdout);

    for (name, options) in BY_HAND {
        desk.done(&format!(
            "simulate {options} -o alone.fits --overwrite --spot-check 40"
        ));
        assert!(
            desk.image("alone.fits") == desk.image(&format!("{name}.fits")),
            "{name}"
        );
        // BITPIX is equal too.
        let start = |file: &str| desk.bytes(file)[80..160].to_vec();
        assert_eq!(start("alone.fits"), start(&format!("{name}.fits")), "{name}");
    }
    assert!(
        desk.image("plain.fits") != desk.image("streamed.fits"),
        "two PSFs"
    );
    assert_eq!(desk.image("truth.fits").dim(), desk.image("quality.fits").dim());
}

#[test]
fn neither_order_nor_threads_nor_company_matter() {
    let desk = night();
    desk.done("batch night.toml --threads 1");
    let files = [
        "plain.fits",
        "stars.fits",
        "double.fits",
        "streamed.fits",
        "part.fits",
        "raw.fits",
        "truth.fits",
    ];
    let first: Vec<Vec<u8>> = files.iter().map(|file| desk.bytes(file)).collect();
    let (defaults, jobs) = NIGHT.split_once("[[job]]").unwrap();
    let mut tables: Vec<&str> = jobs.split("[[job]]").collect();
    tables.reverse();
    let reversed = tables.join("[[job]]");
    desk.write("night.toml", format!("{defaults}[[job]]{reversed}"));
    desk.done("batch night.toml --threads 3 --keep 1 --overwrite");
    for (file, before) in files.iter().zip(&first) {
        assert!(desk.bytes(file) == *before, "{file}");
    }
}

#[test]
fn jobs_of_one_kind_are_prepared_once() {
    let desk = Desk::new();
    desk.write(
        "jobs.csv",
        "scene,output,seed\nscene.fits,a.fits,\nscene.fits,b.fits,3\n",
    );
    let said = lines(&desk.done("batch jobs.csv --set psf=samples.fits --set spot-check=10"));
    assert_eq!(said[0]["reused"], false);
    assert_eq!(said[1]["reused"], true);
    for stage in ["fit", "plan"] {
        assert!(said[0]["report"]["seconds"][stage].as_f64().unwrap() > 0.0);
        // Only warnings are looked for again.
        assert!(said[1]["report"]["seconds"][stage].as_f64().unwrap() < 1e-3);
    }
    // A job with another PSF is between them, and only one PSF is kept.
    desk.write_samples("other.fits", &samples(4, 1));
    desk.write(
        "mixed.csv",
        "psf,output\nsamples.fits,c.fits\nother.fits,d.fits\nsamples.fits,e.fits\n",
    );
    for (keep, reused) in [(1, false), (2, true)] {
        let run = desk.done(&format!(
            "batch mixed.csv --set scene=scene.fits --keep {keep} --overwrite"
        ));
        assert_eq!(lines(&run)[2]["reused"], reused, "--keep {keep}");
    }
}

#[test]
fn a_batch_goes_on_where_it_stopped() {
    let desk = night();
    desk.done("batch night.toml");
    let whole = desk.content();
    let said = lines(&desk.done("batch night.toml"));
    assert_eq!(column(&said, "status"), ["skipped"; 6]);
    assert!(desk.content() == whole);

    // All files of a job must exist.
    std::fs::remove_file(desk.path("raw.fits")).unwrap();
    std::fs::remove_file(desk.path("part.fits")).unwrap();
    let said = lines(&desk.done("batch night.toml"));
    assert_eq!(
        column(&said, "status"),
        ["skipped", "skipped", "skipped", "skipped", "done", "done"]
    );
    assert!(desk.content() == whole, "the same bytes again");

    let said = lines(&desk.done("batch night.toml --overwrite"));
    assert_eq!(column(&said, "status"), ["done"; 6]);
    assert!(desk.content() == whole);
}

#[test]
fn what_other_options_made_is_not_taken_as_done() {
    let desk = night();
    desk.done("batch night.toml");
    desk.write(
        "night.toml",
        NIGHT.replace("tolerance = 1e-6", "tolerance = 1e-5"),
    );
    let before = desk.content();
    let run = desk.run("batch night.toml");
    assert_eq!(run.code, Some(1), "{run:?}");
    let said = lines(&run);
    assert_eq!(
        column(&said, "status"),
        ["skipped", "skipped", "failed", "skipped", "skipped", "skipped"]
    );
    let error = said[2]["error"].as_str().unwrap();
    for needle in ["double.fits", "other options", "--overwrite"] {
        assert!(error.contains(needle), "{error}");
    }
    assert!(
        run.stderr.contains("1 of 6 jobs failed: 3 (double.fits)"),
        "{run:?}"
    );
    assert!(desk.content() == before);

    // Images made without a batch and files that are not images are not overwritten.
    desk.write("jobs.csv", "output\nscene2.fits\nnotes.fits\nnew.fits\n");
    desk.done("simulate scene.fits --psf samples.fits -o scene2.fits");
    desk.write("notes.fits", "not an image");
    let run = desk.run("batch jobs.csv --set psf=samples.fits --set scene=scene.fits");
    assert_eq!(run.code, Some(1), "{run:?}");
    let said = lines(&run);
    assert_eq!(column(&said, "status"), ["failed", "failed", "done"]);
    assert!(
        said[0]["error"]
            .as_str()
            .unwrap()
            .contains("was not made by such a job")
    );
    assert!(said[1]["error"].as_str().unwrap().contains("notes.fits"));
    assert_eq!(desk.bytes("notes.fits"), b"not an image");
}

#[test]
fn an_image_that_failed_its_check_is_not_taken_as_done() {
    let desk = Desk::new();
    desk.write("jobs.csv", "output\nout.fits\n");
    let batch = "batch jobs.csv --set psf=samples.fits --set scene=scene.fits --set spot-check=20";
    desk.done(batch);
    assert_eq!(text(&desk, "out.fits", "PSFCHKV").as_deref(), Some("passed"));
    let mut bytes = desk.bytes("out.fits");
    let place = bytes.windows(6).position(|word| word == b"passed").unwrap();
    bytes[place..place + 6].copy_from_slice(b"failed");
    desk.write("out.fits", bytes);
    let run = desk.run(batch);
    assert_eq!(run.code, Some(1), "{run:?}");
    assert!(lines(&run)[0]["error"].as_str().unwrap().contains("spot check"));
    desk.done(&format!("{batch} --overwrite"));
}

#[test]
fn a_failed_job_does_not_stop_the_rest() {
    let desk = Desk::new();
    desk.write(
        "jobs.csv",
        "scene,output,frame\nmissing.fits,a.fits,\nscene.fits,b.fits,\"40,0,30,30\"\nscene.fits,c.fits,\nscene.fits,none/d.fits,\n",
    );
    let run = desk.run("batch jobs.csv --set psf=samples.fits");
    assert_eq!(run.code, Some(1), "{run:?}");
    let said = lines(&run);
    assert_eq!(column(&said, "status"), ["failed", "failed", "done", "failed"]);
    for (line, needle) in said.iter().zip(["missing.fits", "reaches beyond", "", "none"]) {
        assert!(line["error"].as_str().unwrap_or("").contains(needle), "{line}");
    }
    assert!(
        run.stderr
            .contains("3 of 4 jobs failed: 1 (a.fits), 2 (b.fits), 4 (none/d.fits)"),
        "{run:?}"
    );
    assert!(!run.stderr.contains("panicked"));

    // With --quiet only failures, unless --json is given.
    let quiet = desk.run("batch jobs.csv --set psf=samples.fits -q");
    assert_eq!(column(&lines(&quiet), "status"), ["failed"; 3]);
    let all = desk.run("batch jobs.csv --set psf=samples.fits -q --json");
    assert_eq!(
        column(&lines(&all), "status"),
        ["failed", "failed", "skipped", "failed"]
    );
}

#[test]
fn paths_count_from_the_folder_of_the_file() {
    let desk = Desk::new();
    std::fs::create_dir(desk.path("night")).unwrap();
    std::fs::copy(desk.path("scene.fits"), desk.path("night/field.fits")).unwrap();
    // The file has a byte-order mark, a comment, and blanks around values.
    desk.write(
        "night/jobs.csv",
        "\u{feff}scene, output\n# the first\nfield.fits, out.fits\n",
    );
    // A path on the command line refers to the working directory.
    desk.done("batch night/jobs.csv --set psf=samples.fits");
    desk.done("simulate scene.fits --psf samples.fits -o alone.fits");
    assert!(desk.image("night/out.fits") == desk.image("alone.fits"));

    // A batch that is moved is still complete.
    std::fs::rename(desk.path("night"), desk.path("moved")).unwrap();
    let said = lines(&desk.done("batch moved/jobs.csv --set psf=samples.fits"));
    assert_eq!(column(&said, "status"), ["skipped"]);
}

#[test]
fn images_say_which_command_repeats_them() {
    let desk = Desk::new();
    desk.write("jobs.csv", "scene,output,tolerance\nscene.fits,out.fits,1e-5\n");
    desk.done("batch jobs.csv --set psf=samples.fits");
    let header = desk.header("out.fits");
    let history: String = header
        .iter()
        .filter(|card| card.keyword() == "HISTORY")
        .map(Card::comment_text)
        .collect();
    let command = "psfield simulate --output=out.fits --psf=samples.fits --tolerance=1e-5 -- scene.fits";
    assert!(history.contains(command), "{history:?}");
    assert_eq!(
        text(&desk, "out.fits", "PSFJOB").map(|digest| digest.len()),
        Some(16)
    );
    // An image made from the output of a job is not a result of that job.
    desk.done("simulate out.fits --psf samples.fits -o next.fits");
    assert_eq!(text(&desk, "next.fits", "PSFJOB"), None);
    // The recorded command gives the same image.
    let pixels = desk.image("out.fits");
    desk.done(&format!(
        "{} --overwrite -- scene.fits",
        command[8..].replace(" -- scene.fits", "")
    ));
    assert!(desk.image("out.fits") == pixels);
}

#[test]
fn one_job_may_go_on_from_another() {
    let desk = Desk::new();
    desk.write(
        "jobs.csv",
        "scene,output\nscene.fits,once.fits\nonce.fits,twice.fits\n",
    );
    let said = lines(&desk.done("batch jobs.csv --set psf=samples.fits"));
    assert_eq!(column(&said, "status"), ["done", "done"]);
    assert_ne!(
        text(&desk, "once.fits", "PSFJOB"),
        text(&desk, "twice.fits", "PSFJOB")
    );
}

#[test]
fn toml_that_cannot_be_understood() {
    let desk = Desk::new();
    let good = "[[job]]\nscene = 'scene.fits'\npsf = 'samples.fits'\noutput = 'a.fits'\n";
    let other = good.replace("a.fits", "b.fits");
    for (content, needles) in [
        ("", vec!["no job"]),
        ("[defaults]\npsf = 'samples.fits'\n", vec!["no job"]),
        ("[[job]\n", vec!["jobs.toml"]),
        ("psf = 'samples.fits'\n", vec!["psf", "[defaults]"]),
        ("[job]\npsf = 'samples.fits'\n", vec!["job", "[[job]]"]),
        ("job = [1]\n", vec!["job 1", "[[job]]"]),
        (
            &format!("{good}{other}tolerence = 1e-4\n"),
            vec!["job 2", "--tolerence", "--tolerance"],
        ),
        (
            &format!("{good}{other}tolerance = 2\n"),
            vec!["job 2", "--tolerance", "below 1"],
        ),
        (
            &format!("{good}{other}tolerance = 1979-05-27\n"),
            vec!["job 2", "tolerance", "datetime"],
        ),
        (
            &format!("{good}{other}stream = 1\n"),
            vec!["job 2", "stream", "true or false"],
        ),
        (
            &format!("{good}{other}shape = [61, 51]\n"),
            vec!["job 2", "--shape", "SCENE.fits"],
        ),
        (
            &format!("{good}{other}stamp_size = 3\nstamp-size = 3\n"),
            vec!["job 2", "given twice"],
        ),
        (
            &format!("{good}{other}overwrite = true\n"),
            vec!["job 2", "overwrite", "--overwrite"],
        ),
        (&format!("{good}{other}threads = 2\n"), vec!["job 2", "--threads"]),
        (&format!("{good}{other}help = true\n"), vec!["job 2", "--help"]),
        (
            &format!("{good}{other}method = 'direct'\nstream = true\n"),
            vec!["job 2", "--stream"],
        ),
        (
            &format!("{good}{other}truth = 't.fits'\n"),
            vec!["job 2", "--detector"],
        ),
        (
            &format!("{good}{good}"),
            vec!["job 2", "a.fits", "output of job 1"],
        ),
        (
            &format!("{good}{}", good.replace("'a.fits'", "'./a.fits'")),
            vec!["job 2", "output of job 1"],
        ),
        (
            &format!("{good}{}", good.replace("a.fits", "scene.fits")),
            vec!["job 2", "scene.fits", "input of job 1"],
        ),
        (
            &format!("{good}{}", good.replace("a.fits", "jobs.toml")),
            vec!["job 2", "the jobs file"],
        ),
        (&good.replace("psf =", "#"), vec!["job 1", "--psf"]),
        (&good.replace("output =", "#"), vec!["job 1", "--output"]),
        (
            &good.replace("scene =", "#"),
            vec!["job 1", "nothing to convolve"],
        ),
        (
            &format!("[defaults]\nname = 'x'\n{good}"),
            vec!["name", "each job its own name"],
        ),
    ] {
        desk.write("jobs.toml", content);
        desk.refused("batch jobs.toml", 2, &needles);
    }
}

#[test]
fn csv_and_options_that_cannot_be_understood() {
    let desk = Desk::new();
    let to = "batch jobs.csv --set psf=samples.fits --set scene=scene.fits";
    for (content, needles) in [
        ("output\n", vec!["no job"]),
        ("output,seed\na.fits,1\nb.fits\n", vec!["jobs.csv"]),
        ("output,\na.fits,1\n", vec!["column 2"]),
        (
            "output,seed\r\na.fits,1\r\n\r\n# the other\r\nb.fits,x\r\n",
            vec!["job 2 (line 5)", "--seed"],
        ),
        (
            "output,output\na.fits,b.fits\n",
            vec!["job 1 (line 2)", "output is given twice"],
        ),
        (
            "output,stream\na.fits,yes\n",
            vec!["job 1 (line 2)", "stream", "true or false"],
        ),
        (
            "output\na.fits\na.fits\n",
            vec!["job 2 (line 3)", "output of job 1 (line 2)"],
        ),
    ] {
        desk.write("jobs.csv", content);
        desk.refused(to, 2, &needles);
    }
    desk.write("jobs.csv", "output\na.fits\n");
    desk.refused(
        &format!("{to} --set psf=other.fits"),
        2,
        &["--set", "psf is given twice"],
    );
    desk.refused(&format!("{to} --set seed="), 2, &["--set", "tolerance=1e-5"]);
    desk.refused(&format!("{to} --log a.fits"), 2, &["a.fits", "--log"]);
    desk.refused(&format!("{to} --keep 0"), 2, &["--keep"]);
    desk.refused(&format!("{to} --log none/log.jsonl"), 1, &["none/log.jsonl"]);
    desk.refused("batch missing.toml", 1, &["missing.toml"]);
    desk.refused("batch scene.fits", 2, &["scene.fits", ".toml or .csv"]);
    desk.write("jobs.csv", [0xff, 0xfe, 0x00, b'\n', b'a']);
    desk.refused("batch jobs.csv", 2, &["jobs.csv"]);
    desk.write("jobs.toml", [0xff, 0xfe]);
    desk.refused("batch jobs.toml", 2, &["jobs.toml", "UTF-8"]);
}

#[test]
fn the_help_shows_jobs_files() {
    let help = Desk::empty().done("batch --help").stdout;
    for needle in ["[[job]]", "[defaults]", "JOBS.toml|csv", "--set", "PSFJOB"] {
        assert!(help.contains(needle), "{help}");
    }
}

/// `tests/compatibility/v0.1.0` holds the jobs, their inputs, and the results of psfield 0.1.0.
#[test]
fn a_job_list_of_0_1_0_gives_the_images_of_0_1_0() {
    /// psfield 0.1.0 lost light at the edges of stamps. The images differ by this near the stars:
    /// the influence of the edges of the stamps, which are 13 pixels away.
    const EDGES: f64 = 1e-7;
    /// The pixels of the stars that lie on the frame.
    const STARS: [(usize, usize); 3] = [(12, 30), (70, 11), (50, 72)];
    let near = |(y, x): (usize, usize)| {
        STARS
            .iter()
            .any(|&(column, row)| x.abs_diff(column) <= 3 && y.abs_diff(row) <= 3)
    };
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/compatibility/v0.1.0");
    let desk = Desk::empty();
    for name in [
        "jobs.toml",
        "stars.csv",
        "detector.toml",
        "model.fits",
        "samples.fits",
    ] {
        desk.write(name, std::fs::read(folder.join(name)).unwrap());
    }
    desk.done("batch jobs.toml -q");
    let expected = |name: &str| {
        let image = psfield::psf_io::read_image::<f64>(folder.join(name)).unwrap();
        image.into_parts().0.into_pixels()
    };
    for name in ["expected_stars.fits", "expected_samples.fits"] {
        let (made, expected) = (desk.image(name), expected(name));
        let peak = expected.fold(0.0, |m: f64, v| m.max(v.abs()));
        let off = (&made - &expected)
            .indexed_iter()
            .map(|(at, d)| if near(at) { d.abs() } else { 0.0 })
            .fold(0.0, f64::max);
        assert!(off < EDGES * peak, "{name}: {off:e} of {peak:e}");
    }
    // Such a difference may change a count by one step of the converter, but never by two.
    let counts = &desk.image("expected_counts.fits") - &expected("expected_counts.fits");
    let off = counts.indexed_iter().filter(|&(at, d)| near(at) && *d != 0.0);
    assert!(off.clone().all(|(_, d)| d.abs() <= 1.0));
    assert!(off.count() < 8);
}

/// `tests/compatibility/v0.2.0` holds a list of jobs, a series, their inputs, and the results of psfield 0.2.0.
#[test]
fn jobs_and_a_series_of_0_2_0_give_the_images_of_0_2_0() {
    /// Rounding of images in f32, relative to the peak.
    const SINGLE: f64 = 1e-6;
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/compatibility/v0.2.0");
    let desk = Desk::empty();
    for name in [
        "jobs.toml",
        "series.toml",
        "stars.csv",
        "band.csv",
        "samples.fits",
        "model.fits",
        "table.fits",
    ] {
        desk.write(name, std::fs::read(folder.join(name)).unwrap());
    }
    desk.done("batch jobs.toml -q");
    desk.done("series series.toml --out series -q");
    for (made, expected) in [
        ("expected_colours.fits", "expected_colours.fits"),
        ("expected_model.fits", "expected_model.fits"),
        ("expected_table.fits", "expected_table.fits"),
        ("expected_samples.fits", "expected_samples.fits"),
        ("series/frame_0001.fits", "expected_series.fits"),
    ] {
        let image = psfield::psf_io::read_image::<f64>(folder.join(expected)).unwrap();
        let expected = image.into_parts().0.into_pixels();
        let peak = expected.fold(0.0, |m: f64, v| m.max(v.abs()));
        let off = (&desk.image(made) - &expected).fold(0.0, |m: f64, d| m.max(d.abs()));
        assert!(off < SINGLE * peak, "{made}: {off:e} of {peak:e}");
    }
}
