//! Chooses the sources that are drawn photon by photon to save time.

use crate::plan::cost_model::{CostModel, KindCosts, MOST_PHOTONS};

/// The expected photons of the sources of a frame.
#[derive(Debug, Clone, Copy)]
pub struct ExpectedPhotons<'a> {
    /// Of each star.
    pub stars: &'a [f64],
    /// Of each galaxy or other extended source.
    pub extended: &'a [f64],
    /// Whether pixels without light of sources have a charge, too, such as that of sky. If not, fewer lit pixels
    /// also mean less noise to draw.
    pub has_background: bool,
}

/// The work that the sources of a frame share.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SharedWork {
    /// The number of tables from which the photons of all sources are drawn.
    pub(crate) tables: usize,
    pub(crate) pixels_of_table: usize,
    /// The number of blocks of the frame in which sources are drawn as light.
    pub(crate) blocks: usize,
    pub(crate) pixels_of_frame: usize,
    /// The pixels that a star lights, without regard to the floor. Most galaxies light about as many.
    pub(crate) pixels_of_source: usize,
}

impl SharedWork {
    /// The seconds if so many sources are shot and so many are drawn as light.
    fn seconds(&self, shot: usize, drawn: usize, has_background: bool) -> f64 {
        let tables = self.tables.min(TABLES_OF_SOURCE * shot) * self.pixels_of_table;
        let blocks = self.blocks.min(drawn);
        let lit = if has_background {
            0
        } else {
            self.pixels_of_frame
                .min(self.pixels_of_source.saturating_mul(drawn))
        };
        CostModel::make_tables(tables) + CostModel::source_blocks(blocks) + CostModel::noise(lit)
    }
}

/// A source needs at most about so many tables.
const TABLES_OF_SOURCE: usize = 4;

/// The numbers of photons below which stars and extended sources are drawn photon by photon. Of each kind none
/// are, all, or those that are faster alone, whichever takes the least time together.
pub(crate) fn photons_to_shoot_below(
    photons: ExpectedPhotons<'_>,
    [of_star, of_extended]: [KindCosts; 2],
    shared: SharedWork,
) -> [f64; 2] {
    let choices = |kind: &KindCosts, photons: &[f64]| {
        [0.0, kind.most_photons(), MOST_PHOTONS].map(|below| (below, kind.seconds(photons, below)))
    };
    let extended = choices(&of_extended, photons.extended);
    let mut least = ([0.0; 2], f64::INFINITY);
    for (below_star, (of_stars, shot_stars, drawn_stars)) in choices(&of_star, photons.stars) {
        for (below_extended, (of_extended, shot, drawn)) in extended {
            let of_all = shared.seconds(shot_stars + shot, drawn_stars + drawn, photons.has_background);
            let seconds = of_stars + of_extended + of_all;
            if seconds < least.1 {
                least = ([below_star, below_extended], seconds);
            }
        }
    }
    least.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_choice_takes_the_least_time() {
        let star = KindCosts {
            draw: 4e-6,
            shoot: 1e-6,
            photon: 30e-9,
        };
        let galaxy = KindCosts {
            draw: 90e-6,
            shoot: 5e-6,
            photon: 40e-9,
        };
        let shared = SharedWork {
            tables: 100,
            pixels_of_table: 1000,
            blocks: 16,
            pixels_of_frame: 1 << 20,
            pixels_of_source: 4096,
        };
        let chosen = |stars: &[f64], extended: &[f64], has_background: bool| {
            let photons = ExpectedPhotons {
                stars,
                extended,
                has_background,
            };
            photons_to_shoot_below(photons, [star, galaxy], shared)
        };
        // Many faint stars are shot, and bright ones are drawn.
        assert!((chosen(&vec![3.0; 20_000], &[], true)[0] - 100.0).abs() < 1e-9);
        assert_eq!(chosen(&vec![1000.0; 20_000], &[], true)[0], 0.0);
        // A few stars do not pay for large tables.
        let few = ExpectedPhotons {
            stars: &[3.0; 10],
            extended: &[],
            has_background: true,
        };
        let large = SharedWork {
            pixels_of_table: 1_000_000,
            ..shared
        };
        assert_eq!(photons_to_shoot_below(few, [star, galaxy], large)[0], 0.0);
        // Galaxies take longer to draw.
        let of_galaxies = chosen(&[], &[1000.0; 2000], true)[1];
        assert!((of_galaxies - 2125.0).abs() < 1e-9, "{of_galaxies}");
        // Without a background, brighter stars are shot, too, so that no pixel is lit. Very bright ones never are.
        let stars = [vec![3.0; 20_000], vec![150.0; 12_000]].concat();
        assert_eq!(chosen(&stars, &[], false)[0], MOST_PHOTONS);
        assert!((chosen(&stars, &[], true)[0] - 100.0).abs() < 1e-9);
        assert!(chosen(&[1e7], &[1e7], false).iter().all(|&below| below < 1e7));
    }
}
