//! Misuses of every command: what a run says, and that it leaves all files as they were.
//!
//! Each message must name what is wrong (the option, keyword or value) and where (the file, the row,
//! the job). [`CASES`] holds one case per line, grouped by command.

use std::collections::BTreeSet;
use std::panic::{AssertUnwindSafe, catch_unwind};

use crate::desk::{Desk, NX};
use crate::sampling::TELESCOPE;

/// A command line, its exit status, and words that its message must contain.
type Case = (&'static str, i32, &'static [&'static str]);

/// Bytes of a header card.
const CARD: usize = 80;
/// Bytes of a FITS block.
const BLOCK: usize = 2880;
const DOUBLE: usize = 8;

const COMMANDS: [&str; 15] = [
    "sample",
    "fit",
    "convert",
    "simulate",
    "expose",
    "batch",
    "preview",
    "evaluate",
    "measure",
    "compare",
    "validate",
    "reproduce",
    "bench",
    "demo",
    "devices",
];

// One line per case, as in a table.
#[rustfmt::skip]
const CASES: &[Case] = &[
    // the command line
    ("fitt samples.fits", 2, &["'fitt'"]),
    ("-q", 2, &["requires a subcommand"]),
    ("--threads 2", 2, &["requires a subcommand"]),
    ("--bright fit samples.fits", 2, &["'--bright'"]),
    ("--threads x fit samples.fits -o out.fits", 2, &["'x' for '--threads"]),
    ("devices extra", 2, &["'extra'", "Usage: psfield devices"]),
    ("devices --device gpu", 2, &["'--device'", "Usage: psfield devices"]),
    ("devices --json=all", 2, &["'all' for '--json'"]),
    // sample
    ("sample telescope.toml", 2, &["not provided:\n  --output"]),
    ("sample telescope.toml -o", 2, &["value is required for '--output"]),
    ("sample telescope.toml scene.fits -o out.fits", 2, &["'scene.fits' found"]),
    ("sample telescope.toml -o out.fits --bright", 2, &["'--bright'"]),
    ("sample telescope.toml -o out.fits -o other.fits", 2, &["'--output <SAMPLES.fits>' cannot be used multiple times"]),
    ("sample telescope.toml -o out.fits --threads 0", 2, &["'0' for '--threads"]),
    ("sample telescope.toml -o out.fits --threads 1000000", 2, &["'1000000' for '--threads", "1 to 1024"]),
    ("sample telescope.toml -o out.fits --json=yes", 2, &["'yes' for '--json'"]),
    ("sample telescope.toml -o out.fits --threshold nan", 2, &["'nan' for '--threshold", "above 0"]),
    ("sample telescope.toml -o out.fits --threshold inf", 2, &["'inf' for '--threshold"]),
    ("sample telescope.toml -o out.fits --threshold=", 2, &["'' for '--threshold"]),
    ("sample telescope.toml -o out.fits --threshold few", 2, &["'few' for '--threshold"]),
    ("sample telescope.toml -o out.fits --criterion best", 2, &["'best' for '--criterion", "interpolation"]),
    ("sample telescope.toml -o out.fits --measure l3", 2, &["'l3' for '--measure", "l1, l2"]),
    ("sample telescope.toml -o out.fits --start 5,5,5", 2, &["'5,5,5' for '--start", "two whole numbers"]),
    ("sample telescope.toml -o out.fits --start a,b", 2, &["'a,b' for '--start"]),
    ("sample telescope.toml -o out.fits --start -3,3", 2, &["'-3,3' for '--start"]),
    ("sample telescope.toml -o out.fits --start 100000,100000", 2, &["--start", "from 2 to 4096"]),
    ("sample telescope.toml -o out.fits --uniform 3", 2, &["'3' for '--uniform"]),
    ("sample telescope.toml -o out.fits --uniform 3.5,3", 2, &["'3.5,3' for '--uniform"]),
    ("sample telescope.toml -o out.fits --uniform 3,3 --start 3,3", 2, &["'--uniform <NX,NY>' cannot be used with '--start"]),
    ("sample telescope.toml -o out.fits --uniform 3,3 --accept-cap", 2, &["'--uniform <NX,NY>' cannot be used with '--accept-cap"]),
    ("sample telescope.toml -o out.fits --uniform 3,3 --max-draws 50", 2, &["'--uniform <NX,NY>' cannot be used with '--max-draws"]),
    ("sample telescope.toml -o out.fits --max-draws 0", 2, &["--max-draws", "at least 16, got 0"]),
    ("sample telescope.toml -o out.fits --max-draws many", 2, &["'many' for '--max-draws"]),
    ("sample telescope.toml -o out.fits --verify -1", 2, &["--verify"]),
    ("sample telescope.toml -o out.fits --verify 99999", 2, &["'99999' for '--verify"]),
    ("sample telescope.toml -o out.fits --method grid", 2, &["'grid' for '--method", "kriging, mesh"]),
    ("sample telescope.toml -o out.fits --max-draws 99999999999999999999999", 2, &["'99999999999999999999999' for '--max-draws", "the number is too large"]),
    ("sample telescope.toml -o out.fits --sources s.csv", 2, &["--sources applies only to frames"]),
    ("sample telescope.toml -o out.fits --coverage c.fits", 2, &["--coverage applies only to frames"]),
    ("sample telescope.toml -o out.fits --extension 1", 2, &["--extension applies only to frames"]),
    ("sample telescope.toml -o out.fits --saturation 5", 2, &["--saturation applies only to frames"]),
    ("sample telescope.toml -o out.fits --gain 5", 2, &["--gain applies only to frames"]),
    ("sample telescope.toml -o out.fits --isolation 5", 2, &["--isolation applies only to frames"]),
    ("sample telescope.toml -o out.fits --edge 5", 2, &["--edge applies only to frames"]),
    ("sample telescope.toml -o out.fits --stamp-size 15", 2, &["--stamp-size applies only to frames"]),
    ("sample telescope.toml -o out.fits --oversampling 2", 2, &["--oversampling applies only to frames"]),
    ("sample telescope.toml -o out.fits --registration epsf", 2, &["--registration applies only to frames"]),
    ("sample telescope.toml -o out.fits --background-mesh 32", 2, &["--background-mesh applies only to frames"]),
    ("sample --preset hubble -o out.fits", 2, &["'hubble' for '--preset", "survey-2m"]),
    ("sample --preset survey-2m telescope.toml -o out.fits", 2, &["'--preset <PRESET>' cannot be used with"]),
    ("sample scene.fits -o out.fits --measure l1", 2, &["--measure applies only to telescopes"]),
    ("sample scene.fits -o out.fits --start 3,3", 2, &["--start applies only to telescopes"]),
    ("sample scene.fits -o out.fits --accept-cap", 2, &["--accept-cap applies only to telescopes"]),
    ("sample scene.fits -o out.fits --snr inf", 2, &["'inf' for '--snr"]),
    ("sample scene.fits -o out.fits --snr many", 2, &["'many' for '--snr"]),
    ("sample scene.fits -o out.fits --saturation full", 2, &["'full' for '--saturation"]),
    ("sample scene.fits -o out.fits --gain 0", 2, &["'0' for '--gain", "above 0"]),
    ("sample scene.fits -o out.fits --gain 1 --read-noise nan", 2, &["'nan' for '--read-noise"]),
    ("sample scene.fits -o out.fits --isolation -1", 2, &["'-1' for '--isolation"]),
    ("sample scene.fits -o out.fits --edge -1", 2, &["'-1' for '--edge"]),
    ("sample scene.fits -o out.fits --stamp-size wide", 2, &["'wide' for '--stamp-size"]),
    ("sample scene.fits -o out.fits --oversampling 2.5", 2, &["'2.5' for '--oversampling", "a whole number is needed"]),
    ("sample scene.fits -o out.fits --registration fit", 2, &["'fit' for '--registration", "epsf"]),
    ("sample scene.fits -o out.fits --extension=", 2, &["'' for '--extension"]),
    ("sample scene.fits -o out.fits --extension SCI", 1, &["scene.fits", "HDU SCI", "--extension"]),
    ("sample scene.fits -o out.fits", 1, &["scene.fits", "no noise"]),
    ("sample folder -o out.fits", 1, &["folder", "not a regular file"]),
    ("sample none.toml -o out.fits", 1, &["none.toml", "cannot read"]),
    ("sample none.fits -o out.fits", 1, &["none.fits: cannot read the file"]),
    ("sample at.csv -o out.fits", 1, &["at.csv is neither a FITS image nor a telescope file"]),
    ("sample empty.toml -o out.fits", 1, &["empty.toml", "wavelength_nm"]),
    ("sample detector.toml -o out.fits", 1, &["detector.toml", "photon_noise"]),
    ("sample samples.fits -o out.fits", 1, &["samples.fits is PSF samples"]),
    ("sample cube.fits -o out.fits", 1, &["cube.fits is a cube"]),
    ("sample model.fits -o out.fits", 1, &["model.fits is a PSF model"]),
    ("sample field.psf -o out.fits", 1, &["field.psf is a PSFEx model"]),
    ("sample table.fits -o out.fits", 1, &["table.fits is a table"]),
    ("sample tiny.fits -o out.fits", 1, &["tiny.fits", "3 x 51 pixels is too small"]),
    ("sample short.fits -o out.fits", 1, &["short.fits", "HDU 0", "cut short"]),
    ("sample bscale.fits -o out.fits", 1, &["bscale.fits", "HDU 0", "BSCALE", "abc"]),
    ("sample axes.fits -o out.fits", 1, &["axes.fits", "HDU 0", "NAXIS"]),
    ("sample nan.fits -o out.fits", 1, &["nan.fits", "pixel [12, 5]", "NaN"]),
    ("sample telescope.toml -o there.fits", 1, &["there.fits", "exists", "--overwrite"]),
    ("sample telescope.toml -o folder --overwrite", 1, &["folder", "not a regular file"]),
    ("sample scene.fits -o out.fits --sources there.csv", 1, &["there.csv", "exists", "--overwrite"]),
    ("sample scene.fits -o out.fits --coverage none/c.fits", 1, &["none/c.fits", "no directory none"]),
    ("sample t-unknown.toml -o out.fits", 1, &["t-unknown.toml", "line 1", "`nane`"]),
    ("sample t-wavelength-0.toml -o out.fits", 1, &["t-wavelength-0.toml", "wavelength_nm", "above 0"]),
    ("sample t-wavelength-nan.toml -o out.fits", 1, &["t-wavelength-nan.toml", "wavelength_nm", "NaN"]),
    ("sample t-wavelength-word.toml -o out.fits", 1, &["t-wavelength-word.toml", "line 2", "\"red\""]),
    ("sample t-no-wavelength.toml -o out.fits", 1, &["t-no-wavelength.toml", "missing field `wavelength_nm`"]),
    ("sample t-scale.toml -o out.fits", 1, &["t-scale.toml", "pixel_scale_arcsec", "-0.1"]),
    ("sample t-scale-huge.toml -o out.fits", 1, &["t-scale-huge.toml", "pixel scale"]),
    ("sample t-wavelength-huge.toml -o out.fits", 1, &["t-wavelength-huge.toml", "wavelength_nm = 1.0e30"]),
    ("sample t-value-huge.toml -o out.fits --uniform 2,2", 1, &["t-value-huge.toml", "(0, 0)", "e28 frame pixels off"]),
    ("sample t-frame.toml -o out.fits", 1, &["t-frame.toml", "a frame of 0 x 96"]),
    ("sample t-frame-half.toml -o out.fits", 1, &["t-frame-half.toml", "line 4", "nx = 1.5", "a whole number"]),
    ("sample t-stamp.toml -o out.fits", 1, &["t-stamp.toml", "a stamp of 0 x 24"]),
    ("sample t-stamp-huge.toml -o out.fits", 1, &["t-stamp-huge.toml", "6144"]),
    ("sample t-diameter.toml -o out.fits", 1, &["t-diameter.toml", "aperture.diameter_m"]),
    ("sample t-obscuration.toml -o out.fits", 1, &["t-obscuration.toml", "aperture.obscuration"]),
    ("sample t-spider.toml -o out.fits", 1, &["t-spider.toml", "aperture.spider.width_m", "9"]),
    ("sample t-unit.toml -o out.fits", 1, &["t-unit.toml", "line 9", "`mm`", "`nm`"]),
    ("sample t-noll.toml -o out.fits", 1, &["t-noll.toml", "wavefront.modes[0].noll", "got 0"]),
    ("sample t-noll-twice.toml -o out.fits", 1, &["t-noll-twice.toml", "wavefront.modes[1]", "noll = 4"]),
    ("sample t-power.toml -o out.fits", 1, &["t-power.toml", "wavefront.modes[0].terms[0].x", "99"]),
    ("sample t-value.toml -o out.fits", 1, &["t-value.toml", "wavefront.modes[0].terms[0].value", "inf"]),
    ("sample t-response.toml -o out.fits", 1, &["t-response.toml", "line 13", "boolean"]),
    ("sample t-twice.toml -o out.fits", 1, &["t-twice.toml", "line 12", "duplicate key"]),
    ("sample t-seeing.toml -o out.fits", 1, &["t-seeing.toml", "seeing.fwhm_arcsec", "-1"]),
    ("sample t-blur.toml -o out.fits", 1, &["t-blur.toml", "detector.blur_sigma_px", "NaN"]),
    ("sample t-oversampling.toml -o out.fits", 1, &["t-oversampling.toml", "stamp.oversampling", "1 to 64"]),
    ("sample t-padding.toml -o out.fits", 1, &["t-padding.toml", "stamp.padding", "1 to 16"]),
    // fit
    ("fit", 2, &["not provided:\n  --output", "\n  <SAMPLES.fits>...\n"]),
    ("fit samples.fits model.fits -o out.fits", 1, &["model.fits is a fitted model already"]),
    ("fit samples.fits -o out.fits --basis pca", 1, &["pca: cannot read the file"]),
    ("fit samples.fits -o out.fits --json x", 1, &["x: cannot read the file"]),
    ("fit samples.fits -o out.fits --rank 1.5", 2, &["'1.5' for '--rank"]),
    ("fit samples.fits -o out.fits --rank=", 2, &["'' for '--rank"]),
    ("fit samples.fits -o out.fits --rank 99999999999999999999999", 2, &["for '--rank", "whole number"]),
    ("fit samples.fits -o out.fits --rank energy=nan", 2, &["'energy=nan' for '--rank"]),
    ("fit samples.fits -o out.fits --rank energy=", 2, &["'energy=' for '--rank"]),
    ("fit samples.fits -o out.fits --rank error=-1", 2, &["'error=-1' for '--rank"]),
    ("fit samples.fits -o out.fits --rank 9", 1, &["samples.fits", "rank 9", "only 8"]),
    ("fit samples.fits -o out.fits --centring=", 2, &["'' for '--centring", "mean"]),
    ("fit samples.fits -o out.fits --interpolation idw=0", 2, &["'idw=0' for '--interpolation"]),
    ("fit samples.fits -o out.fits --interpolation idw=nan", 2, &["'idw=nan' for '--interpolation"]),
    ("fit samples.fits -o out.fits --interpolation polynomial", 2, &["'polynomial' for '--interpolation"]),
    ("fit samples.fits -o out.fits --interpolation polynomial=21", 2, &["'polynomial=21' for '--interpolation"]),
    ("fit samples.fits -o out.fits --interpolation polynomial=3", 1, &["samples.fits", "degree 3", "10 samples"]),
    ("fit samples.fits -o out.fits --sample-noise -1", 2, &["'-1' for '--sample-noise"]),
    ("fit samples.fits -o out.fits --sample-noise nan", 2, &["'nan' for '--sample-noise"]),
    ("fit samples.fits -o out.fits --sample-noise much", 2, &["'much' for '--sample-noise"]),
    ("fit samples.fits -o out.fits --psf-extension 0", 2, &["samples.fits", "option --psf-extension"]),
    ("fit samples.fits -o out.fits --psf-order sorted", 2, &["samples.fits", "option --psf-order"]),
    ("fit samples.fits -o out.fits --psf-order up", 2, &["'up' for '--psf-order"]),
    ("fit samples.fits -o out.fits --psf-detector 0", 2, &["'0' for '--psf-detector"]),
    ("fit samples.fits -o out.fits --psf-wavelength 2.2", 2, &["samples.fits", "option --psf-wavelength"]),
    ("fit samples.fits -o out.fits --psf-oversampling nan", 2, &["'nan' for '--psf-oversampling"]),
    ("fit samples.fits -o out.fits --psf-centre nan,3", 2, &["'nan,3' for '--psf-centre"]),
    ("fit samples.fits -o out.fits --pixel-response half", 2, &["'half' for '--pixel-response", "missing"]),
    ("fit cube.fits -o out.fits", 1, &["cube.fits", "HDU 0", "9 stamps", "--psf-positions"]),
    ("fit cube.fits -o out.fits --psf-positions none.csv", 1, &["none.csv", "cannot read"]),
    ("fit cube.fits -o out.fits --psf-positions folder", 1, &["folder", "not a regular file"]),
    ("fit cube.fits -o out.fits --psf-positions at.csv", 1, &["cube.fits", "positions", "9", "1"]),
    ("fit cube.fits -o out.fits --psf-positions words.csv", 1, &["words.csv", "line 3", "\"x\"", "\"here\""]),
    ("fit cube.fits -o out.fits --psf-positions nan.csv", 1, &["nan.csv", "line 3", "\"x\"", "NaN"]),
    ("fit cube.fits -o out.fits --psf-positions ragged.csv", 1, &["ragged.csv", "line 3", "2 fields"]),
    ("fit cube.fits -o out.fits --psf-positions columns.csv", 1, &["columns.csv", "\"x\"", "\"a\", \"b\""]),
    ("fit cube.fits -o out.fits --psf-positions scene.fits", 1, &["scene.fits", "no binary table", "x, y"]),
    ("fit cube.fits -o out.fits --psf-positions nine.csv --psf-centre 99,7", 1, &["cube.fits", "centre (99, 7)", "15 x 15"]),
    ("fit none.fits -o out.fits", 1, &["none.fits", "cannot read"]),
    ("fit folder -o out.fits", 1, &["folder", "not a regular file"]),
    ("fit empty.fits -o out.fits", 1, &["empty.fits", "not a FITS file"]),
    ("fit text.fits -o out.fits", 1, &["text.fits", "not a FITS file"]),
    ("fit scene.fits -o out.fits", 1, &["scene.fits", "POSITIONS", "OVERSAMP", "--psf-oversampling"]),
    ("fit table.fits -o out.fits", 1, &["table.fits", "no image"]),
    ("fit field.psf -o out.fits", 1, &["field.psf", "PSFEx"]),
    ("fit axes.fits -o out.fits", 1, &["axes.fits", "HDU 0", "NAXIS"]),
    ("fit s-centre.fits -o out.fits", 1, &["s-centre.fits", "HDU 0", "CENX", "centre (99, 7)"]),
    ("fit s-oversampling.fits -o out.fits", 1, &["s-oversampling.fits", "HDU 0", "OVERSAMP", "above 0, got 0"]),
    ("fit s-interpolation.fits -o out.fits", 1, &["s-interpolation.fits", "HDU 0", "STAMPINT", "lanczos3", "linear"]),
    ("fit s-centre-word.fits -o out.fits", 1, &["s-centre-word.fits", "HDU 0", "CENX", "\"mid\""]),
    ("fit s-field-0.fits -o out.fits", 1, &["s-field-0.fits", "HDU 0", "FIELDNX", "got 0"]),
    ("fit s-field-half.fits -o out.fits", 1, &["s-field-half.fits", "HDU 0", "FIELDNX", "61.5"]),
    ("fit s-field-alone.fits -o out.fits", 1, &["s-field-alone.fits", "HDU 0", "FIELDNX", "missing"]),
    ("fit s-field-small.fits -o out.fits", 1, &["s-field-small.fits", "sample 1", "(30, 0)", "outside", "20 x 51"]),
    ("fit s-response.fits -o out.fits", 1, &["s-response.fits", "HDU 0", "PIXCONV", "T or F"]),
    ("fit s-column.fits -o out.fits", 1, &["s-column.fits", "\"Y\"", "\"X\", \"Z\""]),
    ("fit s-format.fits -o out.fits", 1, &["s-format.fits", "HDU 1", "\"Y\"", "8A"]),
    ("fit s-rows.fits -o out.fits", 1, &["s-rows.fits", "POSITIONS", "8", "9"]),
    ("fit s-row.fits -o out.fits", 1, &["s-row.fits", "HDU 1", "NAXIS1"]),
    ("fit s-fields.fits -o out.fits", 1, &["s-fields.fits", "HDU 1", "TFORM3"]),
    ("fit samples.fits -o folder --overwrite", 1, &["folder", "not a regular file"]),
    ("fit samples.fits -o none/deep/out.fits", 1, &["none/deep/out.fits", "no directory none/deep"]),
    ("fit samples.fits -o ./samples.fits --overwrite", 2, &["./samples.fits", "input"]),
    // convert
    ("convert model.fits", 2, &["not provided:\n  --output"]),
    ("convert model.fits -o out.fits", 2, &["--to", "psf-samples", "gridded"]),
    ("convert model.fits -o out.fits --to png", 2, &["'png' for '--to"]),
    ("convert model.fits -o out.fits --to=", 2, &["'' for '--to"]),
    ("convert model.fits -o out.fits --to gridded=3", 2, &["'gridded=3' for '--to"]),
    ("convert samples.fits -o out.psf --to psfex=11", 2, &["'psfex=11' for '--to", "0 to 10"]),
    ("convert samples.fits -o out.psf --to psfex=two", 2, &["'psfex=two' for '--to", "0 to 10"]),
    ("convert samples.fits -o out.psf --to psfex=5", 1, &["samples.fits", "degree 5", "21 terms", "lower degree"]),
    ("convert model.fits -o out.psf", 1, &["model.fits", "not a polynomial", "--to psfex=DEGREE"]),
    ("convert model.fits -o out.fits --to psf-model --grid 3,3", 2, &["--grid", "psf-samples"]),
    ("convert model.fits -o out.psf --to psfex=1 --at at.csv", 2, &["--at", "psf-samples"]),
    ("convert model.fits -o out.fits --to gridded --grid 1,1", 1, &["model.fits", "regular grid", "--grid"]),
    ("convert model.fits -o out.fits --to gridded --grid 3", 2, &["'3' for '--grid"]),
    ("convert model.fits -o out.fits --to gridded --grid a,b", 2, &["'a,b' for '--grid"]),
    ("convert model.fits -o out.fits --to psf-samples --grid 99999999999999999999,1", 2, &["'99999999999999999999,1' for '--grid"]),
    ("convert model.fits -o out.fits --to gridded --grid 100000,100000", 2, &["--grid 100000,100000", "65536"]),
    ("convert model.fits -o out.fits --to psf-samples --at far.csv", 1, &["model.fits", "far.csv", "(300, 400)", "61 x 51"]),
    ("convert model.fits -o out.fits --to psf-samples --grid 3,3 --at at.csv", 2, &["'--grid <NX,NY>' cannot be used with '--at"]),
    ("convert model.fits -o out.fits --to psf-samples --at=", 2, &["'--at <POSITIONS.csv>'"]),
    ("convert model.fits -o out.fits --to psf-samples --at none.csv", 1, &["none.csv", "cannot read"]),
    ("convert model.fits -o out.fits --to psf-samples --at folder", 1, &["folder", "not a regular file"]),
    ("convert model.fits -o out.fits --to psf-samples --at words.csv", 1, &["words.csv", "line 3", "\"x\"", "\"here\""]),
    ("convert model.fits -o out.fits --to psf-samples --at nan.csv", 1, &["nan.csv", "line 3", "\"x\"", "NaN"]),
    ("convert model.fits -o out.fits --to psf-samples --at ragged.csv", 1, &["ragged.csv", "line 3", "2 fields"]),
    ("convert model.fits -o out.fits --to psf-samples --at columns.csv", 1, &["columns.csv", "\"x\"", "\"a\", \"b\""]),
    ("convert model.fits -o out.fits --to psf-samples --at samples.fits --table 3", 1, &["samples.fits", "HDU 3", "POSITIONS", "--table"]),
    ("convert model.fits -o out.fits --to psf-samples --at at.csv --columns x=a", 2, &["'x=a' for '--columns", "both x and y"]),
    ("convert model.fits -o out.fits --to psf-samples --at at.csv --columns z=a,y=b", 2, &["'z=a,y=b' for '--columns", "with a role out of"]),
    ("convert model.fits -o out.fits --to psf-samples --at at.csv --columns x=x,x=y", 2, &["'x=x,x=y' for '--columns", "once per role"]),
    ("convert model.fits -o out.fits --to psf-samples --at at.csv --columns x=a,y=b", 1, &["at.csv", "\"a\"", "\"x\", \"y\""]),
    ("convert model.fits -o out.fits --to psf-samples --columns x=a,y=b", 2, &["--columns applies only", "--at"]),
    ("convert model.fits -o out.fits --to psf-samples --one-based", 2, &["--one-based applies only", "--at"]),
    ("convert model.fits -o out.fits --to psf-samples --table 1", 2, &["--table applies only", "--at"]),
    ("convert model.fits -o out.fits --to gridded --precision f64", 2, &["--precision applies only to psf-samples"]),
    ("convert model.fits -o out.fits --to psf-samples --rank 2", 2, &["model.fits", "not fitted", "option --rank"]),
    ("convert field.psf -o out.fits --to psf-model --interpolation nearest", 2, &["field.psf", "not fitted", "option --interpolation"]),
    ("convert field.psf -o out.fits --to psf-model --psf-extension OTHER", 1, &["field.psf", "HDU OTHER", "PSF_DATA", "--psf-extension"]),
    ("convert field.psf -o out.fits --to psf-model --psf-detector 1", 2, &["field.psf", "STDPSF", "option --psf-detector"]),
    ("convert field.psf -o out.fits --to psf-model --psf-positions at.csv", 2, &["field.psf", "cubes", "option --psf-positions"]),
    ("convert field.psf -o out.fits --to psf-model --pixel-scale 0", 2, &["'0' for '--pixel-scale"]),
    ("convert field.psf -o out.fits --to psf-model --field-centre 1", 2, &["'1' for '--field-centre", "two numbers"]),
    ("convert field.psf -o out.fits --to psf-model --psf-wavelength -1", 2, &["'-1' for '--psf-wavelength"]),
    ("convert samples.fits -o out.fits --to psf-samples --interpolation nearest", 2, &["--grid", "--at", "--normalise"]),
    ("convert empty.fits -o out.fits --to psf-model", 1, &["empty.fits", "not a FITS file"]),
    ("convert table.fits -o out.fits --to psf-model", 1, &["table.fits", "no image"]),
    ("convert short.fits -o out.fits --to psf-model --psf-oversampling 1", 1, &["short.fits", "HDU 0", "cut short"]),
    ("convert inf.fits -o out.fits --to psf-model --psf-oversampling 1", 1, &["inf.fits", "pixel [12, 5]", "inf"]),
    ("convert bscale.fits -o out.fits --to psf-model --psf-oversampling 1", 1, &["bscale.fits", "HDU 0", "BSCALE", "abc"]),
    ("convert dark.fits -o out.fits --to psf-model --psf-oversampling 1", 1, &["dark.fits", "sample 0", "positive flux"]),
    ("convert model.fits -o there.fits --to psf-samples", 1, &["there.fits", "exists", "--overwrite"]),
    ("convert model.fits -o none/out.psf --to psfex=1", 1, &["none/out.psf", "no directory none"]),
    ("convert model.fits -o folder --to psf-samples --overwrite", 1, &["folder", "not a regular file"]),
    // simulate
    ("simulate", 2, &["not provided:\n  --psf <PSF>\n  --output"]),
    ("simulate scene.fits -o out.fits", 2, &["not provided:\n  --psf"]),
    ("simulate scene.fits --psf model.fits --psf samples.fits -o out.fits", 2, &["'--psf <PSF>' cannot be used multiple times"]),
    ("simulate scene.fits --psf model.fits -o out.fits --blur 3", 2, &["'--blur'"]),
    ("simulate scene.fits --psf= -o out.fits", 2, &["required for '--psf"]),
    ("simulate --shape 61,51 --wcs scene.fits --psf model.fits -o out.fits", 2, &["nothing to convolve", "--catalog"]),
    ("simulate scene.fits --wcs scene.fits --psf model.fits -o out.fits", 2, &["cannot be used with '--wcs"]),
    ("simulate --catalog stars.csv --shape 61,51 --wcs none.fits --psf model.fits -o out.fits", 1, &["none.fits", "cannot read"]),
    ("simulate --catalog stars.csv --shape 61,51 --wcs text.fits --psf model.fits -o out.fits", 1, &["text.fits", "not a FITS file"]),
    ("simulate --catalog stars.csv --shape 61,51 --wcs scene.fits --extension 5 --psf model.fits -o out.fits", 1, &["scene.fits", "HDU 5", "--extension"]),
    ("simulate --catalog sky.csv --shape 61,51 --wcs scene.fits --psf model.fits -o out.fits", 1, &["sky.csv", "\"ra\" and \"dec\"", "scene.fits", "CTYPE1"]),
    ("simulate --catalog stars.csv --shape 61 --psf model.fits -o out.fits", 2, &["'61' for '--shape"]),
    ("simulate --catalog stars.csv --shape -5,5 --psf model.fits -o out.fits", 2, &["'-5,5' for '--shape"]),
    ("simulate --catalog stars.csv --shape 1000000,1000000 --psf model.fits -o out.fits", 2, &["--shape: 1000000 x 1000000"]),
    ("simulate --catalog stars.csv --shape 100,100 --psf model.fits -o out.fits", 1, &["model.fits", "100 x 100", "61 x 51", "--frame"]),
    ("simulate --catalog stars.csv --shape 61,51 --extension 0 --psf model.fits -o out.fits", 2, &["--extension needs a scene"]),
    ("simulate --catalog stars.csv --shape 61,51 --stream --psf model.fits -o out.fits", 2, &["--stream needs a scene"]),
    ("simulate scene.fits --psf model.fits -o out.fits --catalog none.csv", 1, &["none.csv", "cannot read"]),
    ("simulate scene.fits --psf model.fits -o out.fits --catalog folder", 1, &["folder", "not a regular file"]),
    ("simulate scene.fits --psf model.fits -o out.fits --catalog columns.csv", 1, &["columns.csv", "\"flux\"", "\"a\", \"b\""]),
    ("simulate scene.fits --psf model.fits -o out.fits --catalog words.csv", 1, &["words.csv", "line 3", "\"x\"", "\"here\""]),
    ("simulate scene.fits --psf model.fits -o out.fits --catalog inf.csv", 1, &["inf.csv", "line 3", "\"flux\"", "\"inf\""]),
    ("simulate scene.fits --psf model.fits -o out.fits --catalog ragged.csv", 1, &["ragged.csv", "line 3", "2 fields"]),
    ("simulate scene.fits --psf model.fits -o out.fits --catalog galaxy.csv", 1, &["galaxy.csv", "line 2", "index n", "99"]),
    ("simulate scene.fits --psf model.fits -o out.fits --catalog axis.csv", 1, &["axis.csv", "line 2", "axis ratio q", "got 2"]),
    ("simulate scene.fits --psf model.fits -o out.fits --catalog radius.csv", 1, &["radius.csv", "line 2", "radius re", "-4"]),
    ("simulate scene.fits --psf model.fits -o out.fits --catalog mag.csv", 1, &["mag.csv", "\"mag\"", "--zero-point"]),
    ("simulate scene.fits --psf model.fits -o out.fits --catalog mag.csv --zero-point bright", 2, &["'bright' for '--zero-point"]),
    ("simulate scene.fits --psf model.fits -o out.fits --catalog mag.csv --zero-point nan", 2, &["'nan' for '--zero-point"]),
    ("simulate scene.fits --psf model.fits -o out.fits --catalog mag.csv --zero-point 1e9", 1, &["mag.csv", "line 2", "(1, 2)", "inf"]),
    ("simulate scene.fits --psf model.fits -o out.fits --catalog huge.csv", 1, &["huge.csv", "1e300", "--precision"]),
    ("simulate scene.fits --psf model.fits -o out.fits --catalog twice.csv", 1, &["twice.csv", "\"x\"", "more than once"]),
    ("simulate scene.fits --psf model.fits -o out.fits --catalog scene.fits", 1, &["scene.fits", "no binary table", "x, y, flux"]),
    ("simulate scene.fits --psf model.fits -o out.fits --catalog samples.fits", 1, &["samples.fits", "\"flux\"", "\"X\", \"Y\""]),
    ("simulate scene.fits --psf model.fits -o out.fits --catalog samples.fits --table 9", 1, &["samples.fits", "HDU 9", "POSITIONS", "--table"]),
    ("simulate scene.fits --psf model.fits -o out.fits --catalog stars.csv --columns x=x,y=y,flux=F", 1, &["stars.csv", "\"F\"", "\"flux\""]),
    ("simulate scene.fits --psf model.fits -o out.fits --catalog stars.csv --columns x=x,y=y,flux=flux,mag=flux", 2, &["'--columns", "either for flux or for mag"]),
    ("simulate scene.fits --psf model.fits -o out.fits --catalog stars.csv --columns x=x,y=y,size=flux", 2, &["'--columns", "with a role out of", "size=flux"]),
    ("simulate scene.fits --psf model.fits -o out.fits --table 1", 2, &["--table needs", "--catalog"]),
    ("simulate scene.fits --psf model.fits -o out.fits --zero-point 25", 2, &["--zero-point needs", "--catalog"]),
    ("simulate scene.fits --psf model.fits -o out.fits --skip-invalid", 2, &["--skip-invalid needs", "--catalog"]),
    ("simulate scene.fits --psf model.fits -o out.fits --oversampling 1.5", 2, &["'1.5' for '--oversampling"]),
    ("simulate scene.fits --psf model.fits -o out.fits --oversampling 65", 2, &["'65' for '--oversampling"]),
    ("simulate scene.fits --psf model.fits -o out.fits --frame a,b,c,d", 2, &["'a,b,c,d' for '--frame"]),
    ("simulate scene.fits --psf model.fits -o out.fits --frame 60,50,5,5", 2, &["first pixel 60, 50", "61 x 51", "--frame"]),
    ("simulate scene.fits --psf model.fits -o out.fits --extension 3", 1, &["scene.fits", "HDU 3", "--extension"]),
    ("simulate scene.fits --psf model.fits -o out.fits --tolerance 1", 2, &["'1' for '--tolerance", "below 1"]),
    ("simulate scene.fits --psf model.fits -o out.fits --tolerance nan", 2, &["'nan' for '--tolerance"]),
    ("simulate scene.fits --psf model.fits -o out.fits --tolerance=", 2, &["'' for '--tolerance"]),
    ("simulate scene.fits --psf model.fits -o out.fits --tolerance-on flux", 2, &["'flux' for '--tolerance-on", "l2 or aperture"]),
    ("simulate scene.fits --psf model.fits -o out.fits --tolerance-on l2 --method basis", 2, &["--tolerance-on", "auto and lowrank"]),
    ("simulate scene.fits --psf model.fits -o out.fits --scene-pixels cell", 2, &["'cell' for '--scene-pixels", "point or integrated"]),
    ("simulate --catalog stars.csv --shape 20,20 --psf model.fits -o out.fits --scene-pixels integrated", 2, &["--scene-pixels", "a scene that is an image"]),
    ("simulate scene.fits --psf model.fits -o out.fits --tolerance 1e-3 --method basis", 2, &["--tolerance", "auto and lowrank"]),
    ("simulate scene.fits --psf model.fits -o out.fits --memory 1G --method basis", 2, &["--memory", "auto and lowrank"]),
    ("simulate scene.fits --psf model.fits -o out.fits --stream --method direct", 2, &["--stream", "auto and lowrank"]),
    ("simulate scene.fits --psf model.fits -o out.fits --memory lots", 2, &["'lots' for '--memory", "256M"]),
    ("simulate scene.fits --psf model.fits -o out.fits --memory 1.5G", 2, &["'1.5G' for '--memory", "256M"]),
    ("simulate scene.fits --psf model.fits -o out.fits --spot-check all", 2, &["'all' for '--spot-check", "a whole number is needed"]),
    ("simulate scene.fits --psf model.fits -o out.fits --seed pi", 2, &["'pi' for '--seed"]),
    ("simulate scene.fits --psf model.fits -o out.fits --spot-check 10000000", 2, &["'10000000' for '--spot-check", "100000"]),
    ("simulate inf.fits --psf model.fits -o out.fits --nan-as 0", 1, &["inf.fits", "pixel [12, 5]", "inf"]),
    ("simulate scene.fits --psf model.fits -o out.fits --seed 99999999999999999999", 2, &["'99999999999999999999' for '--seed"]),
    ("simulate scene.fits --psf model.fits -o out.fits --method", 2, &["required for '--method"]),
    ("simulate scene.fits --psf model.fits -o out.fits --method patch=x", 2, &["'patch=x' for '--method", "patch=N"]),
    ("simulate scene.fits --psf model.fits -o out.fits --stamp-size big", 2, &["'big' for '--stamp-size"]),
    ("simulate scene.fits --psf model.fits -o out.fits --stamp-size 8193", 2, &["'8193' for '--stamp-size", "8192"]),
    ("simulate scene.fits --psf model.fits -o out.fits --device tpu", 2, &["'tpu' for '--device", "cpu"]),
    ("simulate scene.fits --psf model.fits -o out.fits --device gpu --method direct", 2, &["--device gpu", "auto and lowrank"]),
    ("simulate scene.fits --psf model.fits -o out.fits --device gpu --precision f64", 2, &["--device gpu", "--precision f64"]),
    ("simulate scene.fits --psf model.fits -o out.fits --device cpu --gpu-adapter nvidia", 2, &["--gpu-adapter", "--device cpu"]),
    ("simulate scene.fits --psf model.fits -o out.fits --device cpu --gpu-memory 1G", 2, &["--gpu-memory", "--device cpu"]),
    ("simulate scene.fits --psf model.fits -o out.fits --device gpu --gpu-memory lots", 2, &["'lots' for '--gpu-memory"]),
    ("simulate scene.fits --psf model.fits -o out.fits --truth t.fits", 2, &["not provided:\n  --detector"]),
    ("simulate scene.fits --psf model.fits -o out.fits --quality q.fits", 2, &["not provided:\n  --detector"]),
    ("simulate scene.fits --psf model.fits -o out.fits --detector none.toml", 1, &["none.toml", "cannot read"]),
    ("simulate scene.fits --psf model.fits -o out.fits --detector empty.toml", 2, &["empty.toml", "no settings"]),
    ("simulate scene.fits --psf model.fits -o out.fits --detector telescope.toml", 1, &["telescope.toml", "line 6", "`aperture`"]),
    ("simulate scene.fits --psf model.fits -o out.fits --detector detector.toml --truth t.fits --no-truth", 2, &["'--truth <TRUTH.fits>' cannot be used with '--no-truth'"]),
    ("simulate scene.fits --psf model.fits -o out.fits --detector detector.toml --truth there.fits", 1, &["there.fits", "exists", "--overwrite"]),
    ("simulate scene.fits --psf model.fits -o out.fits --detector detector.toml --quality folder", 1, &["folder", "not a regular file"]),
    ("simulate scene.fits --psf samples.fits -o out.fits --rank 33", 1, &["samples.fits", "rank 33", "only 8"]),
    ("simulate scene.fits --psf samples.fits -o out.fits --interpolation polynomial=9", 1, &["samples.fits", "degree 9", "55 samples"]),
    ("simulate scene.fits --psf model.fits -o out.fits --psf-oversampling 2", 2, &["model.fits", "option --psf-oversampling"]),
    ("simulate scene.fits --psf cube.fits -o out.fits", 1, &["cube.fits", "HDU 0", "--psf-positions"]),
    ("simulate scene.fits --psf table.fits -o out.fits", 1, &["table.fits", "no image"]),
    ("simulate scene.fits --psf folder -o out.fits", 1, &["folder", "not a regular file"]),
    ("simulate scene.fits --psf telescope.toml -o out.fits", 1, &["telescope.toml", "not a FITS file"]),
    ("simulate scene.fits --psf p-degree.psf -o out.fits", 1, &["p-degree.psf", "HDU 1", "POLDEG1", "99"]),
    ("simulate folder --psf model.fits -o out.fits", 1, &["folder", "not a regular file"]),
    ("simulate stars.csv --psf model.fits -o out.fits", 1, &["stars.csv", "not a FITS file"]),
    ("simulate table.fits --psf model.fits -o out.fits", 1, &["table.fits", "no image"]),
    ("simulate cube.fits --psf model.fits -o out.fits", 1, &["cube.fits", "HDU 0", "[9, 15, 15]", "[y, x]"]),
    ("simulate header.fits --psf model.fits -o out.fits", 1, &["header.fits", "HDU 0", "cut short"]),
    ("simulate bscale.fits --psf model.fits -o out.fits", 1, &["bscale.fits", "HDU 0", "BSCALE", "abc"]),
    ("simulate bzero.fits --psf model.fits -o out.fits", 1, &["bzero.fits", "HDU 0", "BZERO", "1E400"]),
    ("simulate axes.fits --psf model.fits -o out.fits", 1, &["axes.fits", "HDU 0", "NAXIS"]),
    ("simulate bitpix.fits --psf model.fits -o out.fits", 1, &["bitpix.fits", "HDU 0", "BITPIX", "-64"]),
    ("simulate negative.fits --psf model.fits -o out.fits", 1, &["negative.fits", "HDU 0", "NAXIS1", "negative"]),
    ("simulate no-axis.fits --psf model.fits -o out.fits", 1, &["no-axis.fits", "HDU 0", "NAXIS2", "missing"]),
    ("simulate huge.fits --psf model.fits -o out.fits", 1, &["huge.fits", "HDU 0", "cut short"]),
    ("simulate scale-huge.fits --psf model.fits -o out.fits", 1, &["scale-huge.fits", "HDU 0", "pixel [8, 10]", "inf"]),
    ("simulate nan.fits --psf model.fits -o out.fits --stream", 1, &["nan.fits", "pixel [12, 5]", "NaN"]),
    ("simulate scene.fits --psf model.fits -o folder --overwrite", 1, &["folder", "not a regular file"]),
    ("simulate scene.fits --psf model.fits -o ./model.fits --overwrite", 2, &["./model.fits", "input"]),
    // expose
    ("expose", 2, &["not provided:\n  --output", "\n  <IMAGE.fits>\n"]),
    ("expose scene.fits -o out.fits --photons-only --mask scene.fits", 2, &["'--photons-only' cannot be used with '--mask"]),
    ("expose scene.fits -o out.fits --photon-noise --shutter", 2, &["'--shutter'"]),
    ("expose scene.fits -o out.fits --photon-noise --sky", 2, &["required for '--sky"]),
    ("expose scene.fits -o out.fits --photon-noise --sky inf", 2, &["'inf' for '--sky", "0 or above"]),
    ("expose scene.fits -o out.fits --photon-noise --sky dark", 2, &["'dark' for '--sky"]),
    ("expose scene.fits -o out.fits --photon-noise --sky=", 2, &["'' for '--sky"]),
    ("expose scene.fits -o out.fits --photon-noise --electrons-per-flux 0", 2, &["'0' for '--electrons-per-flux"]),
    ("expose scene.fits -o out.fits --photon-noise --exposure -1", 2, &["'-1' for '--exposure"]),
    ("expose scene.fits -o out.fits --photon-noise --dark -1 --exposure 10", 2, &["'-1' for '--dark"]),
    ("expose scene.fits -o out.fits --photon-noise --full-well 0", 2, &["'0' for '--full-well"]),
    ("expose scene.fits -o out.fits --photon-noise --read-noise -1", 2, &["'-1' for '--read-noise"]),
    ("expose scene.fits -o out.fits --photon-noise --gain nan", 2, &["'nan' for '--gain"]),
    ("expose scene.fits -o out.fits --photon-noise --bias low", 2, &["'low' for '--bias", "a number is needed"]),
    ("expose scene.fits -o out.fits --photon-noise --bias nan", 2, &["--bias", "NaN"]),
    ("expose scene.fits -o out.fits --photon-noise --bits 0", 2, &["'0' for '--bits", "24"]),
    ("expose scene.fits -o out.fits --photon-noise --bits 16.5", 2, &["'16.5' for '--bits"]),
    ("expose scene.fits -o out.fits --photon-noise --seed 1.5", 2, &["'1.5' for '--seed"]),
    ("expose scene.fits -o out.fits --photon-noise --extension 2", 1, &["scene.fits", "HDU 2", "--extension"]),
    ("expose scene.fits -o out.fits --photon-noise --extension SCI,x", 2, &["'SCI,x' for '--extension"]),
    ("expose scene.fits -o out.fits --photon-noise --mask none.fits", 1, &["none.fits", "cannot read"]),
    ("expose scene.fits -o out.fits --photon-noise --mask scene.fits", 1, &["scene.fits", "mask", "pixel [8, 8]"]),
    ("expose scene.fits -o out.fits --photon-noise --mask cube.fits", 1, &["cube.fits", "[9, 15, 15]"]),
    ("expose scene.fits -o out.fits --photon-noise --mask text.fits", 1, &["text.fits", "not a FITS file"]),
    ("expose scene.fits -o out.fits --photon-noise --mask nan.fits", 1, &["nan.fits", "pixel [12, 5]", "NaN"]),
    ("expose scene.fits -o out.fits --detector folder", 1, &["folder", "cannot read"]),
    ("expose scene.fits -o out.fits --detector empty.toml", 2, &["empty.toml", "no settings"]),
    ("expose scene.fits -o out.fits --detector at.csv", 1, &["at.csv", "line 1"]),
    ("expose scene.fits -o out.fits --detector d-word.toml", 1, &["d-word.toml", "line 1", "\"bright\""]),
    ("expose scene.fits -o out.fits --detector d-bool.toml", 1, &["d-bool.toml", "line 1", "boolean"]),
    ("expose scene.fits -o out.fits --detector d-nan.toml", 1, &["d-nan.toml", "sky_e", "NaN"]),
    ("expose scene.fits -o out.fits --detector d-gain.toml", 1, &["d-gain.toml", "gain_e_per_adu", "got 0"]),
    ("expose scene.fits -o out.fits --detector d-bits.toml", 1, &["d-bits.toml", "bits", "got 25"]),
    ("expose scene.fits -o out.fits --detector d-well.toml", 1, &["d-well.toml", "full_well_e", "got 0"]),
    ("expose scene.fits -o out.fits --detector d-flux.toml", 1, &["d-flux.toml", "electrons_per_flux", "got 0"]),
    ("expose scene.fits -o out.fits --detector d-response.toml", 1, &["d-response.toml", "response_rms", "-1"]),
    ("expose scene.fits -o out.fits --detector d-dead.toml", 1, &["d-dead.toml", "bad_pixels.dead_fraction", "got 2"]),
    ("expose scene.fits -o out.fits --detector d-sum.toml", 1, &["d-sum.toml", "bad_pixels.hot_fraction", "bad_pixels.dead_fraction"]),
    ("expose scene.fits -o out.fits --detector d-hot.toml", 1, &["d-hot.toml", "bad_pixels.hot_dark_e_per_s"]),
    ("expose scene.fits -o out.fits --detector d-pixels.toml", 1, &["d-pixels.toml", "line 3", "`cold_fraction`"]),
    ("expose scene.fits -o out.fits --detector d-syntax.toml", 1, &["d-syntax.toml", "line 1"]),
    ("expose scene.fits -o out.fits --detector d-twice.toml", 1, &["d-twice.toml", "line 2", "duplicate key"]),
    ("expose scene.fits -o out.fits --detector d-gradient.toml", 1, &["d-gradient.toml", "line 1", "`z`", "`x` or `y`"]),
    ("expose scene.fits -o out.fits --detector d-seed.toml", 1, &["d-seed.toml", "line 2", "-1"]),
    ("expose folder -o out.fits --photon-noise", 1, &["folder", "not a regular file"]),
    ("expose empty.fits -o out.fits --photon-noise", 1, &["empty.fits", "not a FITS file"]),
    ("expose table.fits -o out.fits --photon-noise", 1, &["table.fits", "no image"]),
    ("expose model.fits -o out.fits --photon-noise", 1, &["model.fits", "[9, 15, 15]"]),
    ("expose short.fits -o out.fits --photon-noise", 1, &["short.fits", "HDU 0", "cut short"]),
    ("expose bscale.fits -o out.fits --photon-noise", 1, &["bscale.fits", "HDU 0", "BSCALE", "abc"]),
    ("expose axes.fits -o out.fits --photon-noise", 1, &["axes.fits", "HDU 0", "NAXIS"]),
    ("expose inf.fits -o out.fits --photon-noise", 1, &["inf.fits", "pixel [12, 5]", "inf"]),
    ("expose scene.fits -o there.fits --photon-noise", 1, &["there.fits", "exists", "--overwrite"]),
    ("expose scene.fits -o folder --photon-noise --overwrite", 1, &["folder", "not a regular file"]),
    ("expose scene.fits -o out.fits --truth none/t.fits --photon-noise", 1, &["none/t.fits", "no directory none"]),
    ("expose scene.fits -o out.fits --quality there.fits --photon-noise", 1, &["there.fits", "exists", "--overwrite"]),
    // batch
    ("batch", 2, &["not provided:\n  <JOBS.toml|csv>"]),
    ("batch jobs.toml extra", 2, &["'extra'"]),
    ("batch jobs.toml --output out.fits", 2, &["'--output'"]),
    ("batch jobs.toml --keep x", 2, &["'x' for '--keep"]),
    ("batch jobs.toml --keep 1001", 2, &["'1001' for '--keep", "1000"]),
    ("batch jobs.toml --threads 0", 2, &["'0' for '--threads"]),
    ("batch jobs.toml --set", 2, &["required for '--set"]),
    ("batch jobs.toml --set=", 2, &["'' for '--set", "tolerance=1e-5"]),
    ("batch jobs.toml --set tolerance=2", 2, &["'2' for '--tolerance"]),
    ("batch jobs.toml --set seed=1 --set seed=2", 2, &["--set", "seed is given twice"]),
    ("batch jobs.toml --set name=x", 2, &["--set", "name"]),
    ("batch jobs.toml --set overwrite=true", 2, &["overwrite", "--overwrite"]),
    ("batch jobs.toml --set stream=maybe", 2, &["stream", "true or false", "\"maybe\""]),
    ("batch jobs.toml --log jobs.toml", 2, &["--log", "jobs.toml", "the jobs file"]),
    ("batch jobs.toml --log folder", 1, &["log folder", "cannot write"]),
    ("batch jobs.toml --log one.fits", 2, &["job 1", "one.fits", "--log"]),
    ("batch jobs.toml --log=", 2, &["required for '--log"]),
    ("batch none.csv", 1, &["none.csv", "cannot read"]),
    ("batch folder", 2, &["folder", ".toml or .csv"]),
    ("batch empty.toml", 2, &["empty.toml", "no job"]),
    ("batch empty.csv", 2, &["empty.csv", "no job"]),
    ("batch telescope.toml", 2, &["telescope.toml", "[[job]]"]),
    ("batch stars.csv", 2, &["stars.csv", "line 2", "--flux"]),
    ("batch j-unknown.toml", 2, &["j-unknown.toml", "job 2", "--blur"]),
    ("batch j-word.toml", 2, &["j-word.toml", "job 2", "'low' for '--tolerance"]),
    ("batch j-bool.toml", 2, &["j-bool.toml", "job 2", "'true' for '--tolerance"]),
    ("batch j-list.toml", 2, &["j-list.toml", "job 2", "'1,2' for '--tolerance"]),
    ("batch j-range.toml", 2, &["j-range.toml", "job 2", "'0' for '--stamp-size"]),
    ("batch j-nan.toml", 2, &["j-nan.toml", "job 2", "'NaN' for '--tolerance"]),
    ("batch j-seed.toml", 2, &["j-seed.toml", "job 2", "'-1' for '--seed", "a whole number"]),
    ("batch j-no-output.toml", 2, &["j-no-output.toml", "job 2", "--output <IMAGE.fits>"]),
    ("batch j-no-psf.toml", 2, &["j-no-psf.toml", "job 2", "--psf <PSF>"]),
    ("batch j-no-scene.toml", 2, &["j-no-scene.toml", "job 2", "nothing to convolve"]),
    ("batch j-same.toml", 2, &["j-same.toml", "job 2", "one.fits", "output of job 1"]),
    ("batch j-same-place.toml", 2, &["j-same-place.toml", "job 2", "./one.fits", "output of job 1"]),
    ("batch j-input.toml", 2, &["j-input.toml", "job 2", "scene.fits", "input of job 1"]),
    ("batch j-psf.toml", 2, &["j-psf.toml", "job 2", "model.fits", "input of job 1"]),
    ("batch j-order.toml", 2, &["j-order.toml", "job 2", "two.fits", "input of job 1"]),
    ("batch j-truth.toml", 2, &["j-truth.toml", "job 2", "two.fits", "output of job 2"]),
    ("batch j-itself.toml", 2, &["j-itself.toml", "job 2", "the jobs file"]),
    ("batch j-columns.toml", 2, &["j-columns.toml", "job 2", "'x=a' for '--columns"]),
    ("batch j-device.toml", 2, &["j-device.toml", "job 2", "'tpu' for '--device"]),
    ("batch j-date.toml", 2, &["j-date.toml", "job 2", "seed", "datetime"]),
    ("batch j-stream.toml", 2, &["j-stream.toml", "job 2", "stream", "\"yes\""]),
    ("batch j-overwrite.toml", 2, &["j-overwrite.toml", "job 2", "overwrite", "--overwrite"]),
    ("batch j-twice.toml", 2, &["j-twice.toml", "line 9", "duplicate key"]),
    ("batch j-table.toml", 2, &["j-table.toml", "defaults", "[[job]]"]),
    ("batch c-unknown.csv", 2, &["c-unknown.csv", "job 1 (line 2)", "--blur"]),
    ("batch c-ragged.csv", 2, &["c-ragged.csv", "line 2", "2 fields", "3"]),
    ("batch c-header.csv", 2, &["c-header.csv", "no job"]),
    ("batch c-no-output.csv", 2, &["c-no-output.csv", "job 1 (line 2)", "--output"]),
    ("batch c-empty-output.csv", 2, &["c-empty-output.csv", "job 1 (line 2)", "--output"]),
    ("batch c-seed.csv", 2, &["c-seed.csv", "job 1 (line 2)", "'x' for '--seed"]),
    ("batch c-same.csv", 2, &["c-same.csv", "job 2 (line 3)", "out.fits", "output of job 1 (line 2)"]),
    ("batch c-input.csv", 2, &["c-input.csv", "job 2 (line 3)", "scene.fits", "input of job 1 (line 2)"]),
    ("batch c-nameless.csv", 2, &["c-nameless.csv", "column 4"]),
    ("batch c-twice.csv", 2, &["c-twice.csv", "job 1 (line 2)", "psf is given twice"]),
    // preview
    ("preview", 2, &["not provided:\n  <IMAGE.fits>"]),
    ("preview scene.fits cube.fits", 2, &["'cube.fits' found"]),
    ("preview scene.fits -o", 2, &["required for '--output"]),
    ("preview scene.fits --size 3", 2, &["'--size'"]),
    ("preview scene.fits --plane first", 2, &["'first' for '--plane"]),
    ("preview scene.fits --plane 4", 1, &["scene.fits", "HDU 0", "no plane 4"]),
    ("preview cube.fits", 1, &["cube.fits", "HDU 0", "[9, 15, 15]", "--plane"]),
    ("preview cube.fits --plane 9", 1, &["cube.fits", "HDU 0", "no plane 9"]),
    ("preview model.fits", 1, &["model.fits", "HDU 0", "[9, 15, 15]"]),
    ("preview scene.fits --stretch cube", 2, &["'cube' for '--stretch", "asinh"]),
    ("preview scene.fits --percentile 99,1", 2, &["'99,1' for '--percentile", "lower one first"]),
    ("preview scene.fits --percentile nan,99", 2, &["'nan,99' for '--percentile"]),
    ("preview scene.fits --percentile a,b", 2, &["'a,b' for '--percentile"]),
    ("preview scene.fits --percentile=", 2, &["'' for '--percentile"]),
    ("preview scene.fits --range 5,1", 2, &["'5,1' for '--range", "lower one first"]),
    ("preview scene.fits --range inf,1", 2, &["'inf,1' for '--range"]),
    ("preview scene.fits --range 0,1 --percentile 1,99", 2, &["'--range <LO,HI>' cannot be used with '--percentile"]),
    ("preview scene.fits --colormap rainbow", 2, &["'rainbow' for '--colormap", "viridis"]),
    ("preview scene.fits --max-size 1e3", 2, &["'1e3' for '--max-size"]),
    ("preview scene.fits --max-size 99999999999", 2, &["'99999999999' for '--max-size", "32768"]),
    ("preview scene.fits --extension 1", 1, &["scene.fits", "HDU 1", "--extension"]),
    ("preview scene.fits --extension=", 2, &["'' for '--extension"]),
    ("preview scene.fits -o none/out.png", 1, &["none/out.png", "no directory none"]),
    ("preview scene.fits -o out.fits", 2, &["out.fits", "PNG", ".png"]),
    ("preview folder", 1, &["folder", "not a regular file"]),
    ("preview none.fits", 1, &["none.fits", "cannot read"]),
    ("preview empty.fits", 1, &["empty.fits", "not a FITS file"]),
    ("preview at.csv", 1, &["at.csv", "not a FITS file"]),
    ("preview table.fits", 1, &["table.fits", "no image"]),
    ("preview dark.fits", 1, &["dark.fits", "every finite pixel is 0", "--range"]),
    ("preview short.fits", 1, &["short.fits", "HDU 0", "cut short"]),
    ("preview bscale.fits", 1, &["bscale.fits", "HDU 0", "BSCALE", "abc"]),
    ("preview axes.fits", 1, &["axes.fits", "HDU 0", "NAXIS"]),
    ("preview huge.fits", 1, &["huge.fits", "HDU 0", "cut short"]),
    // evaluate
    ("evaluate", 2, &["not provided:\n  --at <POSITIONS.csv>\n  --output"]),
    ("evaluate model.fits -o out.fits", 2, &["not provided:\n  --at"]),
    ("evaluate --at at.csv -o out.fits", 2, &["not provided:\n  <PSF>"]),
    ("evaluate model.fits --at at.csv -o out.fits --pixels", 2, &["required for '--pixels"]),
    ("evaluate model.fits --at at.csv -o out.fits --size 1e3", 2, &["'1e3' for '--size"]),
    ("evaluate model.fits --at at.csv -o out.fits --size 100000", 2, &["'100000' for '--size", "8192"]),
    ("evaluate model.fits --at at.csv -o out.fits --sub-pixel --pixels model", 2, &["--sub-pixel", "--pixels native"]),
    ("evaluate model.fits --at at.csv -o out.fits --precision f128", 2, &["'f128' for '--precision", "f64"]),
    ("evaluate model.fits --at at.csv -o out.fits --one-based=yes", 2, &["'yes' for '--one-based'"]),
    ("evaluate model.fits --at at.csv -o out.fits --columns x=a,y=b", 1, &["at.csv", "\"a\"", "\"x\", \"y\""]),
    ("evaluate model.fits --at at.csv -o out.fits --columns x=a", 2, &["'x=a' for '--columns", "both x and y"]),
    ("evaluate model.fits --at sky.csv -o out.fits", 1, &["sky.csv", "\"ra\" and \"dec\"", "sky coordinates"]),
    ("evaluate model.fits --at samples.fits -o out.fits --table 0", 1, &["samples.fits", "HDU 0", "POSITIONS", "--table"]),
    ("evaluate model.fits --at samples.fits -o out.fits --table NONE", 1, &["samples.fits", "HDU NONE", "--table"]),
    ("evaluate model.fits --at none.csv -o out.fits", 1, &["none.csv", "cannot read"]),
    ("evaluate model.fits --at folder -o out.fits", 1, &["folder", "not a regular file"]),
    ("evaluate model.fits --at far.csv -o out.fits", 1, &["far.csv", "position 0", "(300, 400)", "61 x 51"]),
    ("evaluate model.fits --at words.csv -o out.fits", 1, &["words.csv", "line 3", "\"x\"", "\"here\""]),
    ("evaluate model.fits --at twice.csv -o out.fits", 1, &["twice.csv", "\"x\"", "more than once"]),
    ("evaluate model.fits --at scene.fits -o out.fits", 1, &["scene.fits", "no binary table", "x, y"]),
    ("evaluate model.fits --at s-column.fits -o out.fits", 1, &["s-column.fits", "\"y\"", "\"X\", \"Z\""]),
    ("evaluate model.fits --at at.csv -o out.fits --outside=", 2, &["'' for '--outside", "extend"]),
    ("evaluate model.fits --at at.csv -o out.fits --psf-order sorted", 2, &["model.fits", "option --psf-order"]),
    ("evaluate none.fits --at at.csv -o out.fits", 1, &["none.fits", "cannot read"]),
    ("evaluate scene.fits --at at.csv -o out.fits", 1, &["scene.fits", "POSITIONS", "--psf-oversampling"]),
    ("evaluate table.fits --at at.csv -o out.fits", 1, &["table.fits", "no image"]),
    ("evaluate m-version.fits --at at.csv -o out.fits", 1, &["m-version.fits", "HDU 0", "PSFMODEL", "\"new\""]),
    ("evaluate m-components.fits --at at.csv -o out.fits", 1, &["m-components.fits", "HDU 0", "NCOMP", "\"all\""]),
    ("evaluate m-oversampling.fits --at at.csv -o out.fits", 1, &["m-oversampling.fits", "HDU 0", "OVERSAMP", "\"two\""]),
    ("evaluate m-interpolation.fits --at at.csv -o out.fits", 1, &["m-interpolation.fits", "HDU 0", "INTERPOL", "bicubic", "got cubic"]),
    ("evaluate m-outside.fits --at at.csv -o out.fits", 1, &["m-outside.fits", "HDU 0", "OUTSIDE", "nearest", "got wrap"]),
    ("evaluate m-normalise.fits --at at.csv -o out.fits", 1, &["m-normalise.fits", "HDU 0", "NORMALIS", "unit", "got sum"]),
    ("evaluate m-short.fits --at at.csv -o out.fits", 1, &["m-short.fits", "cut short"]),
    ("evaluate p-degree.psf --at at.csv -o out.fits", 1, &["p-degree.psf", "HDU 1", "POLDEG1", "99"]),
    ("evaluate p-word.psf --at at.csv -o out.fits", 1, &["p-word.psf", "HDU 1", "POLDEG1", "\"one\""]),
    ("evaluate p-sampling.psf --at at.csv -o out.fits", 1, &["p-sampling.psf", "HDU 1", "PSF_SAMP", "above 0"]),
    ("evaluate p-terms.psf --at at.csv -o out.fits", 1, &["p-terms.psf", "HDU 1", "PSFAXIS3", "7"]),
    ("evaluate p-name.psf --at at.csv -o out.fits", 1, &["p-name.psf", "MAG", "--psf-context"]),
    ("evaluate p-scale.psf --at at.csv -o out.fits", 1, &["p-scale.psf", "HDU 1", "POLSCAL1", "other than 0"]),
    ("evaluate p-group.psf --at at.csv -o out.fits", 1, &["p-group.psf", "HDU 1", "POLGRP1", "got 5"]),
    ("evaluate model.fits --at at.csv -o there.fits", 1, &["there.fits", "exists", "--overwrite"]),
    ("evaluate samples.fits --at samples.fits -o samples.fits --overwrite", 2, &["samples.fits", "input"]),
    // measure
    ("measure", 2, &["not provided:\n  --output", "\n  <IMAGE.fits|STAMPS.fits>\n"]),
    ("measure samples.fits -o out.csv --psf model.fits", 2, &["'--psf'"]),
    ("measure samples.fits -o out.csv --window 70000", 2, &["'70000' for '--window"]),
    ("measure samples.fits -o out.csv --window wide", 2, &["'wide' for '--window"]),
    ("measure samples.fits -o out.csv --background=1", 2, &["'1' for '--background'"]),
    ("measure samples.fits -o out.csv --at=", 2, &["required for '--at"]),
    ("measure samples.fits -o out.csv --at at.csv", 2, &["--at", "samples.fits is PSF samples"]),
    ("measure cube.fits -o out.csv --at at.csv", 2, &["--at", "cube.fits is a cube"]),
    ("measure samples.fits -o out.csv --columns x=a,y=b", 2, &["--columns", "--at"]),
    ("measure samples.fits -o out.csv --one-based", 2, &["--one-based", "--at"]),
    ("measure samples.fits -o out.csv --table 1", 2, &["--table", "--at"]),
    ("measure cube.fits -o out.csv --extension 7", 1, &["cube.fits", "HDU 7", "--extension"]),
    ("measure scene.fits -o out.csv --extension SCI --at at.csv", 1, &["scene.fits", "HDU SCI", "--extension"]),
    ("measure scene.fits -o out.csv --at folder", 1, &["folder", "not a regular file"]),
    ("measure scene.fits -o out.csv --at words.csv", 1, &["words.csv", "line 3", "\"x\"", "\"here\""]),
    ("measure scene.fits -o out.csv --at sky.csv", 1, &["sky.csv", "sky coordinates"]),
    ("measure scene.fits -o out.csv --at ragged.csv", 1, &["ragged.csv", "line 3", "2 fields"]),
    ("measure scene.fits -o out.csv --at at.csv --columns x=q,y=r", 1, &["at.csv", "\"q\"", "\"x\", \"y\""]),
    ("measure none.fits -o out.csv", 1, &["none.fits", "cannot read"]),
    ("measure folder -o out.csv", 1, &["folder", "not a regular file"]),
    ("measure empty.fits -o out.csv", 1, &["empty.fits", "not a FITS file"]),
    ("measure table.fits -o out.csv", 1, &["table.fits", "no image"]),
    ("measure short.fits -o out.csv", 1, &["short.fits", "HDU 0", "cut short"]),
    ("measure bscale.fits -o out.csv", 1, &["bscale.fits", "HDU 0", "BSCALE", "abc"]),
    ("measure axes.fits -o out.csv", 1, &["axes.fits", "HDU 0", "NAXIS"]),
    ("measure nan.fits -o out.csv", 1, &["nan.fits", "pixel [12, 5]", "NaN"]),
    ("measure samples.fits -o there.csv", 1, &["there.csv", "exists", "--overwrite"]),
    ("measure samples.fits -o folder --overwrite", 1, &["folder", "not a regular file"]),
    // compare
    ("compare", 2, &["not provided:\n  <RESULT.fits>\n  <REFERENCE.fits>"]),
    ("compare scene.fits scene.fits cube.fits", 2, &["'cube.fits' found"]),
    ("compare scene.fits scene.fits -o out.txt", 2, &["'-o'"]),
    ("compare scene.fits scene.fits --tolerance 3", 2, &["'--tolerance'"]),
    ("compare scene.fits scene.fits --json=x", 2, &["'x' for '--json'"]),
    ("compare scene.fits scene.fits --extension 3", 1, &["scene.fits", "HDU 3", "--extension"]),
    ("compare scene.fits scene.fits --extension=", 2, &["'' for '--extension"]),
    ("compare scene.fits scene.fits --reference-extension 3", 1, &["scene.fits", "HDU 3", "option --reference-extension"]),
    ("compare scene.fits none.fits", 1, &["none.fits", "cannot read"]),
    ("compare folder scene.fits", 1, &["folder", "not a regular file"]),
    ("compare scene.fits folder", 1, &["folder", "not a regular file"]),
    ("compare scene.fits empty.fits", 1, &["empty.fits", "not a FITS file"]),
    ("compare at.csv scene.fits", 1, &["at.csv", "not a FITS file"]),
    ("compare scene.fits samples.fits", 1, &["scene.fits", "samples.fits", "[1, 51, 61]", "[9, 15, 15]"]),
    ("compare scene.fits tiny.fits", 1, &["scene.fits", "tiny.fits", "[1, 51, 61]", "[1, 51, 3]"]),
    ("compare samples.fits model.fits", 1, &["model.fits is a PSF model"]),
    ("compare scene.fits table.fits", 1, &["table.fits", "no image"]),
    ("compare inf.fits scene.fits", 1, &["inf.fits", "pixel [12, 5]", "inf"]),
    ("compare scene.fits short.fits", 1, &["short.fits", "HDU 0", "cut short"]),
    ("compare bscale.fits scene.fits", 1, &["bscale.fits", "HDU 0", "BSCALE", "abc"]),
    ("compare scene.fits axes.fits", 1, &["axes.fits", "HDU 0", "NAXIS"]),
    // validate
    ("validate", 2, &["not provided:\n  --report", "\n  <PSF|FRAME.fits>\n"]),
    ("validate model.fits --reference samples.fits", 2, &["not provided:\n  --report"]),
    ("validate model.fits --report r", 2, &["model.fits is a PSF model", "--reference"]),
    ("validate model.fits --reference samples.fits --truth samples.fits --report r", 2, &["'--reference <SAMPLES|FRAME.fits>' cannot be used multiple times"]),
    ("validate model.fits --reference samples.fits --report r --snr 5", 2, &["--snr applies only to frames"]),
    ("validate model.fits --reference samples.fits --report r --seed 5", 2, &["'--reference <SAMPLES|FRAME.fits>' cannot be used with '--seed"]),
    ("validate scene.fits --report r --psf-order cards", 2, &["PSF file options need --reference", "scene.fits"]),
    ("validate none.fits --reference samples.fits --report r", 1, &["none.fits", "cannot read"]),
    ("validate folder --reference samples.fits --report r", 1, &["folder", "not a regular file"]),
    ("validate text.fits --reference samples.fits --report r", 1, &["text.fits", "not a FITS file"]),
    ("validate scene.fits --reference samples.fits --report r", 1, &["scene.fits", "POSITIONS", "--psf-oversampling"]),
    ("validate model.fits --reference folder --report r", 1, &["folder", "not a regular file"]),
    ("validate model.fits --reference empty.fits --report r", 1, &["empty.fits", "not a FITS file"]),
    ("validate model.fits --reference table.fits --report r", 1, &["table.fits", "no image"]),
    ("validate model.fits --reference field.psf --report r", 1, &["field.psf is a model", "samples or a frame"]),
    ("validate model.fits --reference scene.fits --report r", 1, &["scene.fits", "no noise"]),
    ("validate model.fits --reference short.fits --report r", 1, &["short.fits", "HDU 0", "cut short"]),
    ("validate model.fits --reference bscale.fits --report r", 1, &["bscale.fits", "HDU 0", "BSCALE", "abc"]),
    ("validate model.fits --reference nan.fits --report r", 1, &["nan.fits", "pixel [12, 5]", "NaN"]),
    ("validate model.fits --reference samples.fits --report r --window 0", 2, &["'0' for '--window"]),
    ("validate model.fits --reference samples.fits --report r --window x", 2, &["'x' for '--window"]),
    ("validate model.fits --reference samples.fits --report r --window 7", 2, &["--window applies only to frames"]),
    ("validate model.fits --reference samples.fits --report r --rank 3", 2, &["model.fits", "not fitted", "option --rank"]),
    ("validate samples.fits --reference samples.fits --report r --rank 33", 1, &["samples.fits", "rank 33", "only 8"]),
    ("validate model.fits --reference samples.fits --report r --psf-order cards", 2, &["model.fits", "option --psf-order"]),
    ("validate model.fits --reference samples.fits --report folder", 1, &["folder", "not empty", "--overwrite"]),
    ("validate model.fits --reference samples.fits --report there.fits", 1, &["there.fits", "cannot be made"]),
    ("validate scene.fits", 2, &["not provided:\n  --report"]),
    ("validate scene.fits --report r", 1, &["scene.fits", "no noise"]),
    ("validate scene.fits --report r --psf model.fits", 2, &["'--psf'"]),
    ("validate scene.fits --report there.fits", 1, &["there.fits", "cannot be made"]),
    ("validate scene.fits --report . --overwrite", 2, &["scene.fits", "another folder"]),
    ("validate folder --report r", 1, &["folder", "not a regular file"]),
    ("validate empty.fits --report r", 1, &["empty.fits", "not a FITS file"]),
    ("validate samples.fits --report r", 2, &["samples.fits is PSF samples", "--reference"]),
    ("validate telescope.toml --report r", 1, &["telescope.toml", "not a FITS file"]),
    ("validate tiny.fits --report r", 1, &["tiny.fits", "3 x 51 pixels is too small"]),
    ("validate short.fits --report r", 1, &["short.fits", "HDU 0", "cut short"]),
    ("validate nan.fits --report r", 1, &["nan.fits", "pixel [12, 5]", "NaN"]),
    ("validate scene.fits --report r --extension 2", 1, &["scene.fits", "HDU 2", "--extension"]),
    ("validate scene.fits --report r --detection-threshold nan", 2, &["'nan' for '--detection-threshold"]),
    ("validate scene.fits --report r --window 2", 2, &["'2' for '--window"]),
    ("validate scene.fits --report r --realisations 0", 2, &["'0' for '--realisations", "1000"]),
    ("validate scene.fits --report r --realisations few", 2, &["'few' for '--realisations"]),
    ("validate scene.fits --report r --no-noise --realisations 3", 2, &["'--no-noise' cannot be used with '--realisations"]),
    ("validate scene.fits --report r --seed x", 2, &["'x' for '--seed"]),
    ("validate scene.fits --report r --snr -1", 2, &["'-1' for '--snr"]),
    ("validate scene.fits --report r --read-noise 3", 2, &["not provided:\n  --gain"]),
    ("validate scene.fits --report r --gain 0", 2, &["'0' for '--gain"]),
    ("validate scene.fits --report r --edge nan", 2, &["'nan' for '--edge"]),
    ("validate scene.fits --report r --registration x", 2, &["'x' for '--registration", "epsf"]),
    ("validate scene.fits --report r --normalise max", 2, &["'max' for '--normalise", "keep"]),
    ("validate scene.fits --report r --rank x", 2, &["'x' for '--rank", "elbow"]),
    // reproduce
    ("reproduce", 2, &["not provided:\n  --report"]),
    ("reproduce --quick --report", 2, &["required for '--report"]),
    ("reproduce --quick --report r extra", 2, &["'extra'"]),
    ("reproduce --quick --report r --preset survey-2m", 2, &["'--preset'"]),
    ("reproduce --quick --report folder", 1, &["folder", "not empty", "--overwrite"]),
    ("reproduce --quick --report there.fits", 1, &["there.fits", "cannot be made"]),
    ("reproduce --quick --report r --frame 0,5", 2, &["'0,5' for '--frame"]),
    ("reproduce --quick --report r --frame 5", 2, &["'5' for '--frame", "two whole numbers"]),
    ("reproduce --quick --report r --frame 10000000,10000000", 2, &["--frame 10000000,10000000", "32768"]),
    ("reproduce --quick --report r --samples 1", 2, &["'1' for '--samples", "200"]),
    ("reproduce --quick --report r --samples 1000000", 2, &["'1000000' for '--samples", "200"]),
    ("reproduce --quick --report r --objects x", 2, &["'x' for '--objects"]),
    ("reproduce --quick --report r --objects 501", 2, &["'501' for '--objects", "500"]),
    ("reproduce --quick --report r --image-side 0", 2, &["'0' for '--image-side", "4096"]),
    ("reproduce --quick --report r --galaxy-side 99999999", 2, &["'99999999' for '--galaxy-side", "2048"]),
    ("reproduce --quick --report r --adaptive-threshold 0", 2, &["'0' for '--adaptive-threshold"]),
    ("reproduce --quick --report r --adaptive-threshold nan", 2, &["'nan' for '--adaptive-threshold"]),
    // bench
    ("bench --quick extra", 2, &["'extra'"]),
    ("bench --quick --sizes=", 2, &["'' for '--sizes", "32768"]),
    ("bench --quick --sizes 64,", 2, &["'' for '--sizes"]),
    ("bench --quick --grids x", 2, &["'x' for '--grids"]),
    ("bench --quick --grids 1000000", 2, &["'1000000' for '--grids", "256"]),
    ("bench --quick --preset survey-2m --psf model.fits", 2, &["'--preset <PRESET>' cannot be used with '--psf"]),
    ("bench --quick --methods direct,fast", 2, &["'fast' for '--methods", "lowrank"]),
    ("bench --quick --tolerances 1e-3,nan", 2, &["'nan' for '--tolerances"]),
    ("bench --quick --rank x", 2, &["'x' for '--rank", "a whole number is needed"]),
    ("bench --quick --rank 0", 2, &["'0' for '--rank", "above 0"]),
    ("bench --quick --pixels x", 2, &["'x' for '--pixels"]),
    ("bench --quick --device auto", 2, &["'auto' for '--device", "cpu"]),
    ("bench --quick --device gpu --precision f64", 2, &["--device gpu", "--precision f64"]),
    ("bench --quick --gpu-adapter x", 2, &["--gpu-adapter", "--device gpu"]),
    ("bench --quick --overwrite=yes", 2, &["'yes' for '--overwrite'"]),
    ("bench --quick --json none/out.json", 1, &["none/out.json", "no directory none"]),
    ("bench --quick --json folder", 1, &["folder", "not a regular file"]),
    ("bench --quick --psf folder", 1, &["folder", "not a regular file"]),
    ("bench --quick --psf scene.fits", 1, &["scene.fits", "POSITIONS"]),
    ("bench --quick --psf table.fits", 1, &["table.fits", "no image"]),
    ("bench --quick --scene text.fits", 1, &["text.fits", "not a FITS file"]),
    ("bench --quick --scene samples.fits", 1, &["samples.fits", "HDU 0", "[9, 15, 15]"]),
    ("bench --quick --scene inf.fits", 1, &["inf.fits", "pixel [12, 5]", "inf"]),
    ("bench --quick --scene short.fits", 1, &["short.fits", "HDU 0", "cut short"]),
    // demo
    ("demo extra", 2, &["'extra'", "Usage: psfield demo"]),
    ("demo --out", 2, &["required for '--out"]),
    ("demo --out there.fits", 1, &["there.fits", "cannot be made"]),
    ("demo --out there.fits/inner", 1, &["there.fits/inner", "cannot be made"]),
    ("demo --seed x", 2, &["'x' for '--seed"]),
    ("demo --seed 1.5", 2, &["'1.5' for '--seed"]),
    ("demo --seed=", 2, &["'' for '--seed"]),
    ("demo --output x", 2, &["'--output'", "--out"]),
    ("demo --quick", 2, &["'--quick'"]),
    ("demo --threads 0", 2, &["'0' for '--threads"]),
];

/// Files of text.
const TEXTS: &[(&str, &str)] = &[
    ("there.fits", "kept"),
    ("there.csv", "kept"),
    ("empty.fits", ""),
    ("empty.csv", ""),
    ("empty.toml", ""),
    ("text.fits", "x,y,flux\n1,2,3\n"),
    ("detector.toml", "photon_noise = true\n"),
    ("at.csv", "x,y\n3,4\n"),
    (
        "nine.csv",
        "x,y\n0,0\n30,0\n60,0\n0,25\n30,25\n60,25\n0,50\n30,50\n60,50\n",
    ),
    ("stars.csv", "x,y,flux\n3,4,5\n"),
    ("far.csv", "x,y\n300,400\n"),
    ("words.csv", "x,y,flux\n1,2,3\nhere,4,5\n"),
    ("nan.csv", "x,y,flux\n1,2,3\nnan,4,5\n"),
    ("inf.csv", "x,y,flux\n1,2,3\n4,5,inf\n"),
    ("ragged.csv", "x,y,flux\n1,2,3\n3,4\n"),
    ("columns.csv", "a,b\n1,2\n"),
    ("twice.csv", "x,x,y,flux\n1,2,3,4\n"),
    ("mag.csv", "x,y,mag\n1,2,20\n"),
    ("sky.csv", "ra,dec,flux\n10,20,3\n"),
    ("huge.csv", "x,y,flux\n1,2,1e300\n"),
    ("galaxy.csv", "x,y,flux,re,n\n1,2,3,4,99\n"),
    ("axis.csv", "x,y,flux,re,n,q\n1,2,3,4,1,2\n"),
    ("radius.csv", "x,y,flux,re,n\n1,2,3,-4,1\n"),
    ("d-word.toml", "sky_e = \"bright\"\n"),
    ("d-bool.toml", "photon_noise = 1\n"),
    ("d-nan.toml", "sky_e = nan\n"),
    ("d-gain.toml", "gain_e_per_adu = 0.0\n"),
    ("d-bits.toml", "bits = 25\n"),
    ("d-well.toml", "full_well_e = 0.0\n"),
    ("d-flux.toml", "electrons_per_flux = 0.0\n"),
    ("d-response.toml", "response_rms = -1.0\n"),
    ("d-dead.toml", "[bad_pixels]\ndead_fraction = 2.0\n"),
    (
        "d-sum.toml",
        "[bad_pixels]\ndead_fraction = 0.6\nhot_fraction = 0.6\nhot_dark_e_per_s = 1.0\n",
    ),
    ("d-hot.toml", "[bad_pixels]\nhot_fraction = 0.1\n"),
    (
        "d-pixels.toml",
        "photon_noise = true\n[bad_pixels]\ncold_fraction = 0.1\n",
    ),
    ("d-syntax.toml", "sky_e = 3 4\n"),
    ("d-twice.toml", "sky_e = 3.0\nsky_e = 4.0\n"),
    ("d-gradient.toml", "sky_gradient_e_per_px = { z = 3.0 }\n"),
    ("d-seed.toml", "response_rms = 0.1\npattern_seed = -1\n"),
    ("j-table.toml", "defaults = 3\n"),
    (
        "c-unknown.csv",
        "output,scene,psf,blur\nout.fits,scene.fits,model.fits,3\n",
    ),
    ("c-ragged.csv", "output,scene,psf\nout.fits,scene.fits\n"),
    ("c-header.csv", "output,scene,psf\n"),
    ("c-no-output.csv", "scene,psf\nscene.fits,model.fits\n"),
    ("c-empty-output.csv", "output,scene,psf\n,scene.fits,model.fits\n"),
    (
        "c-seed.csv",
        "output,scene,psf,seed\nout.fits,scene.fits,model.fits,x\n",
    ),
    (
        "c-same.csv",
        "output,scene,psf\nout.fits,scene.fits,model.fits\nout.fits,scene.fits,model.fits\n",
    ),
    (
        "c-input.csv",
        "output,scene,psf\nout.fits,scene.fits,model.fits\nscene.fits,out.fits,model.fits\n",
    ),
    (
        "c-nameless.csv",
        "output,scene,psf,\nout.fits,scene.fits,model.fits,\n",
    ),
    (
        "c-twice.csv",
        "output,scene,psf,psf\nout.fits,scene.fits,model.fits,model.fits\n",
    ),
];

/// Telescopes with a mistake: the file, a part of [`TELESCOPE`], and what stands there instead.
const TELESCOPES: &[(&str, &str, &str)] = &[
    ("t-unknown.toml", "name", "nane"),
    ("t-wavelength-0.toml", "633.0", "0.0"),
    ("t-wavelength-nan.toml", "633.0", "nan"),
    ("t-wavelength-word.toml", "633.0", "\"red\""),
    ("t-no-wavelength.toml", "wavelength_nm = 633.0\n", ""),
    ("t-scale.toml", "arcsec = 0.1", "arcsec = -0.1"),
    ("t-scale-huge.toml", "arcsec = 0.1", "arcsec = 1e9"),
    ("t-frame.toml", "nx = 128", "nx = 0"),
    ("t-frame-half.toml", "nx = 128", "nx = 1.5"),
    ("t-stamp.toml", "nx = 24", "nx = 0"),
    ("t-stamp-huge.toml", "nx = 24", "nx = 100000"),
    ("t-diameter.toml", "1.2", "0.0"),
    ("t-obscuration.toml", "0.3", "1.0"),
    (
        "t-spider.toml",
        "0.3",
        "0.3, spider = { vanes = 4, width_m = 9.0 }",
    ),
    ("t-unit.toml", "\"nm\"", "\"mm\""),
    ("t-noll.toml", "noll = 4", "noll = 0"),
    (
        "t-noll-twice.toml",
        "}] }",
        "}] }, { noll = 4, terms = [{ value = 1.0 }] }",
    ),
    ("t-power.toml", "x = 2,", "x = 99,"),
    ("t-value.toml", "60.0", "inf"),
    ("t-value-huge.toml", "60.0", "1e30"),
    ("t-wavelength-huge.toml", "633.0", "1e30"),
    ("t-response.toml", "true", "1"),
    ("t-twice.toml", "[detector]", "[wavefront]"),
    (
        "t-seeing.toml",
        "[detector]",
        "[seeing]\nfwhm_arcsec = -1.0\n\n[detector]",
    ),
    ("t-blur.toml", "[detector]", "[detector]\nblur_sigma_px = nan"),
    ("t-oversampling.toml", "ny = 24", "ny = 24, oversampling = 0"),
    ("t-padding.toml", "ny = 24", "ny = 24, padding = 0.5"),
];

/// Two jobs that can be run.
const JOBS: &str = "\
[[job]]\n\
scene = 'scene.fits'\n\
psf = 'model.fits'\n\
output = 'one.fits'\n\
[[job]]\n\
scene = './scene.fits'\n\
psf = './model.fits'\n\
output = 'two.fits'\n\
";

/// Jobs files with a mistake in the second job, described like [`TELESCOPES`].
const JOBS_FILES: &[(&str, &str, &str)] = &[
    (
        "j-unknown.toml",
        "output = 'two.fits'",
        "output = 'two.fits'\nblur = 3",
    ),
    (
        "j-word.toml",
        "output = 'two.fits'",
        "output = 'two.fits'\ntolerance = 'low'",
    ),
    (
        "j-bool.toml",
        "output = 'two.fits'",
        "output = 'two.fits'\ntolerance = true",
    ),
    (
        "j-list.toml",
        "output = 'two.fits'",
        "output = 'two.fits'\ntolerance = [1, 2]",
    ),
    (
        "j-range.toml",
        "output = 'two.fits'",
        "output = 'two.fits'\nstamp-size = 0",
    ),
    (
        "j-nan.toml",
        "output = 'two.fits'",
        "output = 'two.fits'\ntolerance = nan",
    ),
    (
        "j-seed.toml",
        "output = 'two.fits'",
        "output = 'two.fits'\nseed = -1",
    ),
    ("j-no-output.toml", "output = 'two.fits'", ""),
    ("j-no-psf.toml", "psf = './model.fits'", ""),
    ("j-no-scene.toml", "scene = './scene.fits'", ""),
    ("j-same.toml", "two.fits", "one.fits"),
    ("j-same-place.toml", "two.fits", "./one.fits"),
    ("j-input.toml", "two.fits", "scene.fits"),
    ("j-psf.toml", "two.fits", "model.fits"),
    ("j-order.toml", "scene = 'scene.fits'", "scene = 'two.fits'"),
    (
        "j-truth.toml",
        "output = 'two.fits'",
        "output = 'two.fits'\ndetector = 'detector.toml'\ntruth = 'two.fits'",
    ),
    ("j-itself.toml", "two.fits", "j-itself.toml"),
    (
        "j-columns.toml",
        "output = 'two.fits'",
        "output = 'two.fits'\ncolumns = { x = 'a' }",
    ),
    (
        "j-device.toml",
        "output = 'two.fits'",
        "output = 'two.fits'\ndevice = 'tpu'",
    ),
    (
        "j-date.toml",
        "output = 'two.fits'",
        "output = 'two.fits'\nseed = 1979-05-27",
    ),
    (
        "j-stream.toml",
        "output = 'two.fits'",
        "output = 'two.fits'\nstream = 'yes'",
    ),
    (
        "j-overwrite.toml",
        "output = 'two.fits'",
        "output = 'two.fits'\noverwrite = true",
    ),
    (
        "j-twice.toml",
        "output = 'two.fits'",
        "output = 'two.fits'\noutput = 'three.fits'",
    ),
];

/// FITS files with another card: the good file, the bad file, the start of the first card that is
/// replaced, and the new card.
const HEADERS: &[(&str, &str, &str, &str)] = &[
    ("scene.fits", "bscale.fits", "TELESCOP", "BSCALE  = 'abc'"),
    (
        "scene.fits",
        "bzero.fits",
        "TELESCOP",
        "BZERO   =                1E400",
    ),
    (
        "scene.fits",
        "scale-huge.fits",
        "TELESCOP",
        "BSCALE  =                1E307",
    ),
    (
        "scene.fits",
        "axes.fits",
        "NAXIS   =",
        "NAXIS   =                  150",
    ),
    (
        "scene.fits",
        "bitpix.fits",
        "BITPIX",
        "BITPIX  =                   17",
    ),
    (
        "scene.fits",
        "huge.fits",
        "NAXIS1",
        "NAXIS1  =         999999999999",
    ),
    (
        "scene.fits",
        "negative.fits",
        "NAXIS1",
        "NAXIS1  =                  -61",
    ),
    (
        "scene.fits",
        "no-axis.fits",
        "NAXIS2",
        "NAXIX2  =                   51",
    ),
    (
        "scene.fits",
        "tiny.fits",
        "NAXIS1",
        "NAXIS1  =                    3",
    ),
    (
        "samples.fits",
        "s-centre.fits",
        "CENX",
        "CENX    =                 99.0",
    ),
    ("samples.fits", "s-centre-word.fits", "CENX", "CENX    = 'mid'"),
    (
        "samples.fits",
        "s-oversampling.fits",
        "OVERSAMP",
        "OVERSAMP=                  0.0",
    ),
    (
        "samples.fits",
        "s-interpolation.fits",
        "STAMPINT",
        "STAMPINT= 'linear'",
    ),
    (
        "model.fits",
        "m-interpolation.fits",
        "INTERPOL",
        "INTERPOL= 'cubic'",
    ),
    ("model.fits", "m-outside.fits", "OUTSIDE", "OUTSIDE = 'wrap'"),
    ("model.fits", "m-normalise.fits", "NORMALIS", "NORMALIS= 'sum'"),
    (
        "samples.fits",
        "s-field-0.fits",
        "FIELDNX",
        "FIELDNX =                    0",
    ),
    (
        "samples.fits",
        "s-field-half.fits",
        "FIELDNX",
        "FIELDNX =                 61.5",
    ),
    (
        "samples.fits",
        "s-field-alone.fits",
        "FIELDNX",
        "OTHER   =                   61",
    ),
    (
        "samples.fits",
        "s-field-small.fits",
        "FIELDNX",
        "FIELDNX =                   20",
    ),
    (
        "samples.fits",
        "s-response.fits",
        "PIXCONV",
        "PIXCONV =                    3",
    ),
    ("samples.fits", "s-column.fits", "TTYPE2", "TTYPE2  = 'Z'"),
    ("samples.fits", "s-format.fits", "TFORM2", "TFORM2  = '8A'"),
    (
        "samples.fits",
        "s-rows.fits",
        "NAXIS2  =                    9",
        "NAXIS2  =                    8",
    ),
    (
        "samples.fits",
        "s-row.fits",
        "NAXIS1  =                   16",
        "NAXIS1  =                   15",
    ),
    (
        "samples.fits",
        "s-fields.fits",
        "TFIELDS",
        "TFIELDS =                    5",
    ),
    ("model.fits", "m-version.fits", "PSFMODEL", "PSFMODEL= 'new'"),
    ("model.fits", "m-components.fits", "NCOMP", "NCOMP   = 'all'"),
    ("model.fits", "m-oversampling.fits", "OVERSAMP", "OVERSAMP= 'two'"),
    (
        "field.psf",
        "p-degree.psf",
        "POLDEG1",
        "POLDEG1 =                   99",
    ),
    ("field.psf", "p-word.psf", "POLDEG1", "POLDEG1 = 'one'"),
    (
        "field.psf",
        "p-sampling.psf",
        "PSF_SAMP",
        "PSF_SAMP=                  0.0",
    ),
    (
        "field.psf",
        "p-terms.psf",
        "PSFAXIS3",
        "PSFAXIS3=                    7",
    ),
    ("field.psf", "p-name.psf", "POLNAME1", "POLNAME1= 'MAG'"),
    (
        "field.psf",
        "p-scale.psf",
        "POLSCAL1",
        "POLSCAL1=                  0.0",
    ),
    (
        "field.psf",
        "p-group.psf",
        "POLGRP1",
        "POLGRP1 =                    5",
    ),
];

/// A folder with all files that the cases name.
fn desk() -> Desk {
    let desk = Desk::new();
    desk.done("fit samples.fits -o model.fits");
    desk.done("convert samples.fits -o field.psf --to psfex=1 -q");
    std::fs::create_dir(desk.path("folder")).unwrap();
    desk.write("folder/notes.txt", "kept");
    for &(name, text) in TEXTS {
        desk.write(name, text);
    }
    for (name, good, files) in [
        ("telescope.toml", TELESCOPE, TELESCOPES),
        ("jobs.toml", JOBS, JOBS_FILES),
    ] {
        desk.write(name, good);
        for &(bad, part, instead) in files {
            assert!(good.contains(part), "{bad}");
            desk.write(bad, good.replacen(part, instead, 1));
        }
    }
    for &(good, bad, start, card) in HEADERS {
        let mut bytes = desk.bytes(good);
        let at = find(&bytes, start);
        bytes[at..at + CARD].copy_from_slice(format!("{card:<CARD$}").as_bytes());
        desk.write(bad, bytes);
    }
    let scene = desk.bytes("scene.fits");
    let pixels = (find(&scene, "END ") + CARD).next_multiple_of(BLOCK);
    desk.write("header.fits", &scene[..BLOCK / 2]);
    desk.write("short.fits", &scene[..scene.len() - BLOCK]);
    let model = desk.bytes("model.fits");
    desk.write("m-short.fits", &model[..model.len() - BLOCK]);
    for (name, value) in [("nan.fits", f64::NAN), ("inf.fits", f64::INFINITY)] {
        let mut bytes = scene.clone();
        let at = pixels + (12 * NX + 5) * DOUBLE;
        bytes[at..at + DOUBLE].copy_from_slice(&value.to_be_bytes());
        desk.write(name, bytes);
    }
    let mut dark = scene;
    dark[pixels..].fill(0);
    desk.write("dark.fits", dark);
    // The cube without the positions of its stamps, and the positions without the cube.
    let samples = desk.bytes("samples.fits");
    let (cube, table) = samples.split_at(find(&samples, "XTENSION"));
    desk.write("cube.fits", cube);
    let mut empty: Vec<u8> = Vec::new();
    for card in [
        "SIMPLE  =                    T",
        "BITPIX  =                    8",
        "NAXIS   =                    0",
        "EXTEND  =                    T",
        "END",
    ] {
        empty.extend(format!("{card:<CARD$}").into_bytes());
    }
    empty.resize(BLOCK, b' ');
    desk.write("table.fits", [empty.as_slice(), table].concat());
    desk
}

/// Returns where a text begins in the headers of a FITS file.
fn find(bytes: &[u8], text: &str) -> usize {
    let mut cards = bytes.chunks(CARD);
    let found = cards.position(|card| card.starts_with(text.as_bytes()));
    found.unwrap_or_else(|| panic!("no card {text}")) * CARD
}

/// Returns the command of a case, or an empty text for a case of `psfield` itself.
fn command(&(arguments, ..): &Case) -> &'static str {
    let first = arguments.split(' ').next().unwrap_or_default();
    if COMMANDS.contains(&first) { first } else { "" }
}

/// Runs all cases of a command and fails with the list of those that deviate.
fn check(of: &str) {
    let mut desk = desk();
    let mut deviations = Vec::new();
    for case in CASES.iter().filter(|case| command(case) == of) {
        let &(arguments, code, needles) = case;
        let refused = AssertUnwindSafe(|| desk.refused(arguments, code, needles));
        if let Err(panic) = catch_unwind(refused) {
            let message = panic.downcast::<String>();
            deviations.push(message.map_or_else(|_| arguments.to_owned(), |message| *message));
            // The run may have changed files that later cases need.
            desk = self::desk();
        }
    }
    assert!(
        deviations.is_empty(),
        "{} cases deviate:\n{}",
        deviations.len(),
        deviations.join("\n")
    );
}

#[test]
fn the_cases_are_many_and_differ() {
    let lines: BTreeSet<&str> = CASES.iter().map(|case| case.0).collect();
    assert_eq!(lines.len(), CASES.len(), "a command line is given twice");
    assert!(CASES.len() >= 200, "{}", CASES.len());
    for of in COMMANDS {
        assert!(CASES.iter().any(|case| command(case) == of), "{of}");
    }
    for &(arguments, code, needles) in CASES {
        assert!(code == 1 || code == 2, "{arguments}");
        assert!(!needles.is_empty(), "{arguments}");
    }
}

#[test]
fn no_message_advises_an_option_that_does_not_apply() {
    let desk = desk();
    // Two tables with the columns x and y.
    let samples = desk.bytes("samples.fits");
    let table = &samples[find(&samples, "XTENSION")..];
    desk.write("tables.fits", [samples.as_slice(), table].concat());
    for (arguments, names, wrong) in [
        (
            "validate model.fits --reference cube.fits --report r",
            "cube.fits",
            "--psf-positions",
        ),
        (
            "bench --quick --psf model.fits --sizes 512",
            "model.fits",
            "--frame",
        ),
        (
            "fit cube.fits -o out.fits --psf-positions tables.fits",
            "tables.fits",
            "--table",
        ),
        (
            "compare scene.fits scene.fits --reference-extension 3",
            "scene.fits",
            "option --extension",
        ),
    ] {
        let run = desk.run(arguments);
        assert_eq!(run.code, Some(1), "{run:?}");
        assert!(
            run.stderr.contains(names) && !run.stderr.contains(wrong),
            "{run:?}"
        );
    }
}

#[test]
fn misuses_of_the_command_line() {
    check("");
}

#[test]
fn misuses_of_sample() {
    check("sample");
}

#[test]
fn misuses_of_fit() {
    check("fit");
}

#[test]
fn misuses_of_convert() {
    check("convert");
}

#[test]
fn misuses_of_simulate() {
    check("simulate");
}

#[test]
fn misuses_of_expose() {
    check("expose");
}

#[test]
fn misuses_of_batch() {
    check("batch");
}

#[test]
fn misuses_of_preview() {
    check("preview");
}

#[test]
fn misuses_of_evaluate() {
    check("evaluate");
}

#[test]
fn misuses_of_measure() {
    check("measure");
}

#[test]
fn misuses_of_compare() {
    check("compare");
}

#[test]
fn misuses_of_validate() {
    check("validate");
}

#[test]
fn misuses_of_reproduce() {
    check("reproduce");
}

#[test]
fn misuses_of_bench() {
    check("bench");
}

#[test]
fn misuses_of_demo() {
    check("demo");
}

#[test]
fn misuses_of_devices() {
    check("devices");
}
