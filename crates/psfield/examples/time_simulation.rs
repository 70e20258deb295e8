//! Times the library's own call, for `benches/python`. `time_simulation PSF SIZE TOLERANCE REPEAT`
//! prints, for each repetition, the seconds of the whole call and of making the scene from its
//! pixels, which is its first part.

use std::time::Instant;

use ndarray::Array2;
use psfield::psf_types::NoProgress;
use psfield::{Device, Psf, Scene};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [path, size, tolerance, repeat] = arguments.as_slice() else {
        return Err("time_simulation PSF SIZE TOLERANCE REPEAT".into());
    };
    let (size, repeat): (usize, usize) = (size.parse()?, repeat.parse()?);
    // Every pixel is lit.
    let light = Array2::from_shape_fn((size, size), |(y, x)| 1.0 + ((3 * x + 5 * y) % 7) as f32);
    let simulator = Psf::open(path)?
        .simulator((size, size))
        .tolerance(tolerance.parse()?)
        .device(Device::Cpu)
        .build()?;
    simulator.prepare(&Scene::dark(), true, &NoProgress)?;
    for _ in 0..repeat {
        let pixels = light.clone();
        let clock = Instant::now();
        let scene = Scene::new(pixels)?;
        let checked = clock.elapsed().as_secs_f64();
        let image = simulator.simulate(&scene)?;
        println!("{:e} {checked:e}", clock.elapsed().as_secs_f64());
        drop(image);
    }
    Ok(())
}
