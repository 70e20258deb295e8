//! The shaders of one size of planes, ready to run.

use std::sync::Arc;

use super::device::{Attempt, GpuDevice};
use super::error::GpuError;
use super::plane_source::PlaneSource;
use super::shader::Shader;

/// The pipelines of one size of planes.
#[derive(Debug)]
pub(super) struct Pipelines {
    pub(super) source: PlaneSource,
    /// In the order of [`Shader::ALL`].
    of_shaders: [wgpu::ComputePipeline; Shader::ALL.len()],
    pub(super) row_roots: wgpu::Buffer,
    pub(super) column_roots: wgpu::Buffer,
}

impl Pipelines {
    pub(super) fn new(device: &Attempt, source: PlaneSource) -> Result<Arc<Self>, GpuError> {
        // Threads of their own: on those of a pool, other work would come between while the caller holds a lock.
        let of_shaders = std::thread::scope(|scope| {
            let made = Shader::ALL.map(|shader| {
                let source = &source;
                scope.spawn(move || pipeline(device, source, shader))
            });
            made.map(|thread| thread.join().expect("errors go to the device"))
        });
        let row_roots = device.filled("row roots", &words(&source.row_roots()));
        let column_roots = device.filled("column roots", &words(&source.column_roots()));
        device.check()?;
        Ok(Arc::new(Self {
            source,
            of_shaders,
            row_roots,
            column_roots,
        }))
    }

    pub(super) fn get(&self, shader: Shader) -> &wgpu::ComputePipeline {
        let place = Shader::ALL.iter().position(|&s| s == shader);
        &self.of_shaders[place.expect("every shader is among all")]
    }
}

fn pipeline(device: &GpuDevice, source: &PlaneSource, shader: Shader) -> wgpu::ComputePipeline {
    let device = device.device();
    let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some(shader.name()),
        source: wgpu::ShaderSource::Wgsl(source.text(shader).into()),
    });
    device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: Some(shader.name()),
        layout: None,
        module: &module,
        entry_point: Some(shader.name()),
        compilation_options: wgpu::PipelineCompilationOptions {
            // Every value is written before it is read.
            zero_initialize_workgroup_memory: false,
            ..wgpu::PipelineCompilationOptions::default()
        },
        cache: None,
    })
}

fn words(values: &[[f32; 2]]) -> Vec<u32> {
    values.iter().flatten().map(|v| v.to_bits()).collect()
}
