//! `psfield reproduce`.

use psf_types::FrameShape;
use psfield_lab::report::{Reproduction, ReproductionOptions, Software, Target};

use super::UsageError;
use super::context::{Context, command_text, object};
use super::report_folder::{self, ReportFolder};
use super::values::pair;

/// Remake every figure and table of the paper that describes psfield's method
///
/// The paper is Bai, Jia et al. 2025, AJ, "An Ultrafast Image Simulation Technique with Spatially
/// Variable Point-spread Functions" (doi:10.3847/1538-3881/ad9b2e).
///
/// Uses the built-in survey telescope and no data. The report shows singular values, the sampling,
/// FWHM and eccentricity (the paper's ellipticity) of simulated and true objects, and errors over
/// the field and at several tolerances. It compares psfield with patches of constant PSF: for an
/// extended galaxy, and in run time and error (Table 1). It also shows the PSFs of stars of several
/// temperatures, and four frames of a lens with a wide field that share one basis. Takes some 10
/// minutes on two cores, with --quick less than 3.
#[derive(Debug, clap::Args)]
pub(crate) struct ReproduceArgs {
    #[command(flatten)]
    folder: ReportFolder,
    /// Use a smaller frame, with fewer samples and objects
    #[arg(long)]
    quick: bool,
    /// Columns and rows of the frame (pixels) [default: 9232,9216, with --quick 2308,2304]
    #[arg(long, value_name = "NX,NY", value_parser = pair, hide_short_help = true)]
    frame: Option<(usize, usize)>,
    /// PSF samples along each axis [default: 71, with --quick 36]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(4..=200), hide_short_help = true)]
    samples: Option<u16>,
    /// Objects along each axis [default: 54, with --quick 18]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=500), hide_short_help = true)]
    objects: Option<u16>,
    /// Measure Table 1 (run times and errors) on one image of N x N pixels [default: on two, with N
    /// = 512 and 1024]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(32..=4096), hide_short_help = true)]
    image_side: Option<u16>,
    /// Side of the image of the large galaxy (pixels) [default: 512, with --quick 256]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(32..=2048), hide_short_help = true)]
    galaxy_side: Option<u16>,
    /// Largest interpolation error (relative L2) of the non-uniform sampling, which the report
    /// shows next to the uniform sampling [default: 1e-3, with --quick 4e-3]
    #[arg(long, value_name = "X", value_parser = super::values::above_zero, hide_short_help = true)]
    adaptive_threshold: Option<f64>,
}

/// The largest side of the frame. A larger number is probably a typing error.
const MAX_SIDE: usize = 1 << 15;

impl ReproduceArgs {
    pub(crate) fn run(self, context: &Context) -> anyhow::Result<()> {
        self.folder.check(&report_folder::FILES)?;
        let options = self.options()?;
        let bar = context.bar("reproducing");
        let measured = Reproduction::run(&options, &bar)?;
        let tables = [
            ("stars.csv", measured.stars.rows.as_slice()),
            ("galaxies.csv", measured.galaxies.rows.as_slice()),
        ];
        let document = measured.document(Software::of_command(command_text()));
        let files = self
            .folder
            .write(&tables, document, &measured, || measured.sections())?;
        drop(bar);
        let report = object! {
            folder: self.folder.report.as_path(),
            files,
            #[serde(flatten)]
            measured: &measured,
        };
        context.report(&report, || {
            let (folder, targets) = (report.folder.display(), targets_text(&measured.targets));
            let seconds = measured.seconds;
            format!("{targets}{folder}: open report.html first (the run took {seconds:.0} s)")
        })
    }

    fn options(&self) -> anyhow::Result<ReproductionOptions> {
        let mut options = if self.quick {
            ReproductionOptions::quick()
        } else {
            ReproductionOptions::full()
        };
        if let Some((nx, ny)) = self.frame {
            if nx.max(ny) > MAX_SIDE {
                let what =
                    format!("--frame {nx},{ny}: at most {MAX_SIDE} pixels along each axis are possible");
                return Err(UsageError(what).into());
            }
            options.frame = Some(FrameShape::new(nx, ny)?);
        }
        let set = |to: &mut usize, value: Option<u16>| {
            if let Some(value) = value {
                *to = usize::from(value);
            }
        };
        set(&mut options.samples_across, self.samples);
        set(&mut options.objects_across, self.objects);
        set(&mut options.galaxy_side, self.galaxy_side);
        if let Some(side) = self.image_side {
            options.image_sides = vec![usize::from(side)];
        }
        if let Some(threshold) = self.adaptive_threshold {
            options.adaptive_threshold = threshold;
        }
        Ok(options)
    }
}

/// Text with a line per target.
pub(super) fn targets_text(targets: &[Target]) -> String {
    let line = |target: &Target| {
        let measured = target.measured;
        let measured = measured.map_or_else(|| "not measured".to_owned(), |m| format!("{m:.1e}"));
        let verdict = if target.met { "met" } else { "NOT met" };
        let (what, limit) = (&target.what, target.limit);
        format!("{what}: {measured}, psfield's target below {limit:e}: {verdict}\n")
    };
    targets.iter().map(line).collect::<Vec<_>>().concat()
}
