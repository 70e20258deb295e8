//! No output replaces an input or another output, by whatever name or link, and even with
//! `--overwrite`.

use crate::desk::{Desk, points, samples};
use crate::states::coloured;

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

/// A folder with a PSF that depends on the wavelength, and light with spectra in files.
fn colours() -> Desk {
    let desk = Desk::empty();
    desk.write_samples("colour.fits", &coloured());
    for name in ["scene.fits", "layer.fits"] {
        desk.write_image(name, points(&[(20, 20, 1000.0)]));
    }
    desk.write(
        "band.csv",
        "wavelength_um,throughput\n0.5,0\n0.6,1\n0.8,1\n0.9,0\n",
    );
    desk.write("detector.toml", "photon_noise = true\n");
    desk.write("sed.csv", "wavelength_nm,value\n400,1\n1000,2\n");
    desk.write("other.csv", "wavelength_nm,value\n400,2\n1000,1\n");
    desk.write(
        "stars.csv",
        "x,y,flux,sed\n3,4,5,sed.csv\n8,9,5,other.csv:photons\n",
    );
    desk
}

#[test]
fn files_inside_texts_are_files() {
    let desk = colours();
    let image = "scene.fits --psf colour.fits --bandpass band.csv --sed sed.csv";
    let layered = format!("{image} --layer layer.fits:sed=other.csv:photons@z=0.1");
    let sources = "--catalog stars.csv --shape 61,51 --psf colour.fits --bandpass band.csv:um";
    for (command, output) in [
        (image, "band.csv"),
        (image, "sed.csv"),
        (&layered, "layer.fits"),
        (&layered, "other.csv"),
        (sources, "band.csv"),
        (sources, "sed.csv"),
        (sources, "other.csv"),
    ] {
        for place in [
            format!("-o {output}"),
            format!("-o out.fits --detector detector.toml --truth {output}"),
        ] {
            desk.refused(
                &format!("simulate {command} {place} --overwrite"),
                2,
                &[output, "choose another"],
            );
        }
    }
    desk.done(&format!("simulate {layered} -o out.fits"));
    desk.done(&format!("simulate {sources} -o out.fits --overwrite"));
}

#[test]
fn files_inside_texts_of_jobs_begin_in_the_folder_of_the_jobs_file() {
    let desk = colours();
    let layers = "--layer layer.fits:sed=other.csv --layer layer.fits:sed=blackbody:4000";
    desk.done(&format!(
        "simulate scene.fits --psf colour.fits --bandpass band.csv --sed sed.csv {layers} -o alone.fits"
    ));
    std::fs::create_dir(desk.path("sub")).unwrap();
    for name in [
        "colour.fits",
        "scene.fits",
        "layer.fits",
        "band.csv",
        "sed.csv",
        "other.csv",
    ] {
        std::fs::rename(desk.path(name), desk.path("sub").join(name)).unwrap();
    }
    // Files of the same names in the current folder are not meant.
    desk.write("band.csv", "wavelength_um,throughput\n0.5,1\n0.51,1\n");
    desk.write("sed.csv", "no spectrum");
    desk.write("other.csv", "no spectrum");
    let job = "[[job]]\nscene = 'scene.fits'\npsf = 'colour.fits'\nbandpass = 'band.csv:um'\nsed = 'sed.csv'\n\
               layer = ['layer.fits:sed=other.csv', 'layer.fits:sed=blackbody:4000']\n";
    desk.write("sub/jobs.toml", format!("{job}output = 'job.fits'\n"));
    let run = desk.done("batch sub/jobs.toml");
    assert!(run.stdout.contains("\"reused\":false"), "{}", run.stdout);
    assert_eq!(desk.image("sub/job.fits"), desk.image("alone.fits"));
    for output in ["band.csv", "sed.csv", "other.csv", "layer.fits"] {
        desk.write("sub/wrong.toml", format!("{job}output = '{output}'\n"));
        desk.refused(
            "batch sub/wrong.toml --overwrite",
            2,
            &[output, "choose another name"],
        );
    }
}

#[test]
fn spectra_of_a_catalogue_begin_in_its_folder() {
    let desk = colours();
    let simulate = "simulate --shape 61,51 --psf colour.fits --bandpass band.csv";
    desk.done(&format!("{simulate} --catalog stars.csv -o here.fits"));
    std::fs::create_dir(desk.path("sub")).unwrap();
    for name in ["stars.csv", "sed.csv", "other.csv"] {
        std::fs::rename(desk.path(name), desk.path("sub").join(name)).unwrap();
    }
    desk.done(&format!("{simulate} --catalog sub/stars.csv -o there.fits"));
    assert_eq!(desk.image("here.fits"), desk.image("there.fits"));
}
