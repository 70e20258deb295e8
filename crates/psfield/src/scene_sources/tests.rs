//! Scenes put together.

use ndarray::Array2;

use super::*;

fn shape(nx: usize, ny: usize) -> FrameShape {
    FrameShape::new(nx, ny).unwrap()
}

fn at(x: f64, y: f64) -> Position {
    Position::new(x, y).unwrap()
}

fn star(x: f64, y: f64, flux: f64) -> PointSource {
    PointSource::new(at(x, y), flux).unwrap()
}

fn galaxy(x: f64, y: f64, radius: f64) -> SersicSource {
    SersicSource::new(
        at(x, y),
        100.0,
        SersicProfile::new(radius, 1.0, 0.7, 20.0).unwrap(),
    )
    .unwrap()
}

fn ramp(nx: usize, ny: usize) -> Array2<f64> {
    Array2::from_shape_fn((ny, nx), |(y, x)| (10 * y + x) as f64)
}

#[test]
fn everything_is_in_pixels_of_the_padded_scene() {
    let frame = PixelRegion::new(2, 1, shape(10, 8));
    let layout = SceneLayout::of_image(shape(60, 45), 3)
        .unwrap()
        .with_frame(Some(frame))
        .with_reach(4);
    let sources =
        SceneSources::<f64>::new(layout, vec![star(5.0, 2.5, 7.0)], vec![galaxy(-1.0, 0.0, 2.0)]).unwrap();
    assert_eq!(sources.padding(), 12);
    assert_eq!(sources.scene().shape(), shape(60 + 24, 45 + 24));
    let expected = PixelRegion::new(2 * 3 + 12, 3 + 12, shape(30, 24));
    assert_eq!(sources.scene().frame(), expected);
    // The centre of pixel 5 is that of scene pixel 16, and 12 are before it.
    assert_eq!(sources.scene().sources()[0].position(), at(28.0, 20.5));
    assert_eq!(sources.galaxies()[0].position(), at(10.0, 13.0));
    assert_eq!(sources.galaxies()[0].profile().half_light_radius_px(), 6.0);
    // Stars alone reach in from anywhere.
    let stars = SceneSources::<f64>::new(layout, vec![star(5.0, 2.5, 7.0)], Vec::new()).unwrap();
    assert_eq!((stars.padding(), stars.scene().shape()), (0, shape(60, 45)));
}

#[test]
fn owned_and_borrowed_images_give_the_same_light() {
    let (nx, ny) = (20, 15);
    for (galaxies, reach) in [
        (vec![], 3),
        (vec![galaxy(4.0, 3.0, 2.5)], 0),
        (vec![galaxy(-2.0, 3.0, 2.5)], 3),
    ] {
        let layout = SceneLayout::of_image(shape(nx, ny), 1).unwrap().with_reach(reach);
        let sources = SceneSources::<f64>::new(layout, vec![star(3.0, 3.0, 2.0)], galaxies.clone()).unwrap();
        let image = ramp(nx, ny);
        let borrowed = sources.light_of(image.view()).unwrap();
        assert_eq!(borrowed.is_view(), galaxies.is_empty());
        let scene = sources.lit(Some(Image::new(image.clone()).unwrap())).unwrap();
        assert_eq!(scene.pixels().unwrap(), borrowed.view());
        assert_eq!(
            (scene.frame(), scene.sources()),
            (sources.scene().frame(), sources.scene().sources())
        );
        // The image within, and the galaxies' light on it.
        let p = sources.padding();
        let mut light = scene.pixels().unwrap().to_owned();
        light.slice_mut(s![p..p + ny, p..p + nx]).scaled_add(-1.0, &image);
        // All but the light that is off the padded scene.
        let flux = light.sum();
        assert!(
            if galaxies.is_empty() {
                flux == 0.0
            } else {
                (30.0..100.0).contains(&flux)
            },
            "{flux}"
        );
        // Without an image: the galaxies alone.
        let dark = sources.lit(None).unwrap();
        assert_eq!(dark.image().is_some(), !galaxies.is_empty());
        if let Some(pixels) = dark.pixels() {
            // Rounding of the sums above, with values up to 160.
            assert!((&pixels - &light).iter().all(|d: &f64| d.abs() < 1e-12));
        }
    }
}

#[test]
fn what_does_not_fit_is_refused() {
    let layout = SceneLayout::of_image(shape(20, 15), 2).unwrap();
    let frame = |x0, y0, nx, ny| layout.with_frame(Some(PixelRegion::new(x0, y0, shape(nx, ny))));
    let refused = |layout| SceneSources::<f32>::new(layout, Vec::new(), Vec::new()).unwrap_err();
    assert!(matches!(
        refused(layout),
        PsfieldError::UnevenScene { oversample: 2, .. }
    ));
    assert!(SceneSources::<f32>::new(frame(0, 0, 10, 7), Vec::new(), Vec::new()).is_ok());
    for layout in [frame(0, 0, 10, 8), frame(-1, 0, 2, 2)] {
        assert!(matches!(refused(layout), PsfieldError::FrameOffScene { .. }));
    }
    assert!(matches!(
        refused(frame(i64::MAX, 0, 2, 2)),
        PsfieldError::FrameOffAnyScene { .. }
    ));

    let layout = frame(0, 0, 10, 7);
    let bright = vec![star(1.0, 1.0, 1e39)];
    assert!(SceneSources::<f64>::new(layout, bright.clone(), Vec::new()).is_ok());
    assert!(matches!(
        SceneSources::<f32>::new(layout, bright, Vec::new()),
        Err(PsfieldError::FluxBeyondPrecision { flux }) if flux == 1e39
    ));
    // Padding is not counted beyond any memory.
    let huge = layout.with_reach(usize::MAX);
    assert!(matches!(
        SceneSources::<f32>::new(huge, Vec::new(), vec![galaxy(1.0, 1.0, 3.0)]),
        Err(PsfieldError::Data(_))
    ));

    let sources = SceneSources::<f64>::new(layout, Vec::new(), Vec::new()).unwrap();
    let other = ramp(15, 20);
    assert!(matches!(
        sources.light_of(other.view()),
        Err(PsfieldError::Data(DataError::ImageShape { .. }))
    ));
    assert!(sources.lit(Some(Image::new(other).unwrap())).is_err());
}

#[test]
fn warnings_tell_of_stars_between_pixels_and_small_galaxies() {
    let layout = |s| SceneLayout::of_frame(40, 30, s).unwrap().with_reach(5);
    let sources = |s, x, radius| {
        SceneSources::<f64>::new(layout(s), vec![star(x, 4.0, 1.0)], vec![galaxy(5.0, 5.0, radius)]).unwrap()
    };
    for s in [1, 2, 3] {
        assert!(!sources(s, 7.0, 3.0).has_stars_between_pixels(), "{s}");
        assert!(sources(s, 7.25, 3.0).has_stars_between_pixels(), "{s}");
    }
    assert_eq!(sources(1, 7.0, 1.9).small_galaxies(), 1);
    assert_eq!(sources(2, 7.0, 1.9).small_galaxies(), 0);
    assert_eq!(
        sources(1, 7.25, 1.9).warnings(1.0),
        [
            SimulationWarning::StarsBetweenPixels,
            SimulationWarning::SmallGalaxies { count: 1 }
        ]
    );
    assert!(sources(1, 7.25, 3.0).warnings(2.0).is_empty());
}
