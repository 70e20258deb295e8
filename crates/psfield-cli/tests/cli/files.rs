//! No output replaces an input or another output, by whatever name or link, and even with
//! `--overwrite`.

use crate::desk::{Desk, samples};

/// A folder with an input for every command.
fn desk() -> Desk {
    let desk = Desk::new();
    desk.done("fit samples.fits -o model.fits");
    desk.write("telescope.toml", include_str!("../../assets/demo_telescope.toml"));
    desk.write("detector.toml", "photon_noise = true\n");
    desk.write("at.csv", "x,y\n3,4\n");
    desk.write("stars.csv", "x,y,flux\n3,4,5\n");
    desk.write(
        "jobs.toml",
        "[[job]]\npsf = 'model.fits'\nscene = 'scene.fits'\noutput = 'out.fits'\n",
    );
    desk.write_samples("cube.fits", &samples(2, 1));
    desk
}

#[test]
fn an_output_is_never_an_input() {
    let desk = desk();
    for (command, output) in [
        ("sample telescope.toml -o telescope.toml", "telescope.toml"),
        ("sample scene.fits -o scene.fits", "scene.fits"),
        ("sample scene.fits -o out.fits --sources scene.fits", "scene.fits"),
        (
            "sample scene.fits -o out.fits --coverage scene.fits",
            "scene.fits",
        ),
        ("fit samples.fits -o samples.fits", "samples.fits"),
        ("fit cube.fits --psf-positions at.csv -o at.csv", "at.csv"),
        ("convert model.fits --to psfex=1 -o model.fits", "model.fits"),
        (
            "convert model.fits --to psf-samples --at at.csv -o at.csv",
            "at.csv",
        ),
        ("evaluate model.fits --at at.csv -o model.fits", "model.fits"),
        ("evaluate model.fits --at at.csv -o at.csv", "at.csv"),
        ("simulate scene.fits --psf model.fits -o scene.fits", "scene.fits"),
        ("simulate scene.fits --psf model.fits -o model.fits", "model.fits"),
        (
            "simulate scene.fits --catalog stars.csv --psf model.fits -o stars.csv",
            "stars.csv",
        ),
        (
            "simulate scene.fits --psf model.fits --detector detector.toml -o out.fits --truth scene.fits",
            "scene.fits",
        ),
        (
            "simulate scene.fits --psf model.fits --detector detector.toml -o detector.toml",
            "detector.toml",
        ),
        ("expose scene.fits --photon-noise -o scene.fits", "scene.fits"),
        (
            "expose scene.fits --photon-noise -o out.fits --quality scene.fits",
            "scene.fits",
        ),
        ("measure samples.fits -o samples.fits", "samples.fits"),
        ("measure scene.fits --at at.csv -o at.csv", "at.csv"),
        ("preview scene.fits -o scene.fits", "scene.fits"),
        ("bench --quick --psf model.fits --json model.fits", "model.fits"),
        ("bench --quick --scene scene.fits --json scene.fits", "scene.fits"),
        ("validate scene.fits --report .", "scene.fits"),
        (
            "validate model.fits --reference samples.fits --report .",
            "model.fits",
        ),
        ("batch jobs.toml --log jobs.toml", "jobs.toml"),
    ] {
        let overwrite = if command.starts_with("batch") {
            ""
        } else {
            " --overwrite"
        };
        desk.refused(&format!("{command}{overwrite}"), 2, &[output, "choose another"]);
    }
}

#[test]
fn an_output_is_never_another_output() {
    let desk = desk();
    for command in [
        "sample scene.fits -o out.fits --sources out.fits",
        "sample scene.fits -o out.fits --coverage ./out.fits",
        "expose scene.fits --photon-noise -o out.fits --truth out.fits",
        "expose scene.fits --photon-noise -o out.fits --truth t.fits --quality t.fits",
        "simulate scene.fits --psf model.fits --detector detector.toml -o out.fits --truth out.fits",
        "simulate scene.fits --psf model.fits --detector detector.toml -o out.fits --quality out_truth.fits",
        "bench --quick --json out.svg --plot out.svg",
    ] {
        desk.refused(
            &format!("{command} --overwrite"),
            2,
            &["is an output, but also another output", "choose another name"],
        );
    }
}

#[cfg(unix)]
#[test]
fn links_and_spellings_do_not_hide_an_input() {
    let desk = desk();
    std::os::unix::fs::symlink("scene.fits", desk.path("symbolic.fits")).unwrap();
    std::fs::hard_link(desk.path("scene.fits"), desk.path("hard.fits")).unwrap();
    std::fs::create_dir(desk.path("folder")).unwrap();
    let absolute = desk.path("scene.fits");
    for name in [
        "symbolic.fits",
        "hard.fits",
        "./scene.fits",
        "folder/../scene.fits",
        absolute.to_str().unwrap(),
    ] {
        desk.refused(
            &format!("expose scene.fits --photon-noise --overwrite -o {name}"),
            2,
            &[name, "is an output, but also an input"],
        );
    }
    desk.refused(
        "expose symbolic.fits --photon-noise --overwrite -o scene.fits",
        2,
        &["scene.fits is an output, but also an input"],
    );
    std::fs::hard_link(desk.path("jobs.toml"), desk.path("log.jsonl")).unwrap();
    desk.refused("batch jobs.toml --log log.jsonl", 2, &["--log", "the jobs file"]);
}
