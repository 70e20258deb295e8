//! Passes of shader calls.

use pulp::bytemuck::cast_slice;

use super::adapter::Adapter;
use super::buffers::{Growing, InFlight, Readback};
use super::device::{GpuDevice, Pipelines};
use super::plane_source::PlaneSource;
use super::shader::{STRIP, Shader};
use super::stopwatch::Marks;
use crate::error::GpuError;

/// Shader calls of one pass.
#[derive(Debug)]
pub(super) struct Calls<'a> {
    device: &'a GpuDevice,
    pipelines: &'a Pipelines,
    pass: wgpu::ComputePass<'a>,
    params: wgpu::Buffer,
    /// The bytes of all parameters.
    bytes: Vec<u8>,
    /// The number of bytes from the parameters of one call to the next. The parameters of each call
    /// must begin at a multiple of a number that the adapter sets.
    step: usize,
}

/// The size of a call's parameters in bytes.
const PARAM_BYTES: u64 = 32;

/// A buffer for parameters.
pub(super) fn params_buffer() -> Growing {
    Growing::new(
        "parameters",
        wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
    )
}

impl<'a> Calls<'a> {
    /// A pass of at most `most` calls.
    pub(super) fn new(
        device: &'a GpuDevice,
        pipelines: &'a Pipelines,
        params: &mut Growing,
        most: usize,
        encoder: &'a mut wgpu::CommandEncoder,
        marks: Option<wgpu::ComputePassTimestampWrites<'_>>,
    ) -> Self {
        let step = device.device().limits().min_uniform_buffer_offset_alignment as usize;
        let step = step.max(PARAM_BYTES as usize);
        Self {
            device,
            pipelines,
            pass: encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some("shaders"),
                timestamp_writes: marks,
            }),
            params: params.with_room(device, (most * step) as u64),
            bytes: Vec::with_capacity(most * step),
            step,
        }
    }

    /// Adds a call of a shader by `groups` workgroups, unless there are none. `params` are the
    /// words of the call's [`Params`](super::shader::Params). Buffers are bound in the order of the
    /// shader's bindings, after the parameters.
    pub(super) fn add(
        &mut self,
        shader: Shader,
        params: [u32; 8],
        buffers: &[&wgpu::Buffer],
        groups: (u32, u32),
    ) {
        if groups.0 == 0 || groups.1 == 0 {
            return;
        }
        let offset = self.bytes.len() as u64;
        for word in params {
            self.bytes.extend_from_slice(&word.to_le_bytes());
        }
        self.bytes.resize(offset as usize + self.step, 0);
        let params = wgpu::BindingResource::Buffer(wgpu::BufferBinding {
            buffer: &self.params,
            offset,
            size: wgpu::BufferSize::new(PARAM_BYTES),
        });
        let others = buffers.iter().map(|buffer| buffer.as_entire_binding());
        let entries: Vec<wgpu::BindGroupEntry<'_>> = std::iter::once(params)
            .chain(others)
            .enumerate()
            .map(|(binding, resource)| wgpu::BindGroupEntry {
                binding: binding as u32,
                resource,
            })
            .collect();
        let pipeline = self.pipelines.get(shader);
        let bindings = self
            .device
            .device()
            .create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some(shader.name()),
                layout: &pipeline.get_bind_group_layout(0),
                entries: &entries,
            });
        self.pass.set_pipeline(pipeline);
        self.pass.set_bind_group(0, &bindings, &[]);
        self.pass.dispatch_workgroups(groups.0, groups.1, 1);
    }

    /// Ends the pass, and writes the parameters to their buffer before the next submission.
    pub(super) fn end(self) {
        self.device.queue().write_buffer(&self.params, 0, &self.bytes);
    }
}

/// One call of one shader on a caller's data, so that tests can check each shader separately. It
/// does not belong to this crate's interface.
#[doc(hidden)]
#[derive(Debug)]
pub struct ShaderTrial<'a> {
    /// The name of the shader.
    pub name: &'a str,
    /// Columns and rows of the planes.
    pub planes: (usize, usize),
    /// The words of `Params` in `common.wgsl`.
    pub params: [u32; 8],
    /// The words of the buffers that are bound after the parameters, in order. `None` stands for
    /// the roots of unity. The shader changes the last buffer.
    pub buffers: Vec<Option<Vec<u32>>>,
    /// The number of tiles, or of planes if the shader works on single planes.
    pub count: u32,
    /// The number of rows of the tallest result to which stamps are drawn.
    pub highest: u32,
    /// If true, one root of unity is made wrong, so that a test can check that it notices the
    /// error.
    pub spoilt: bool,
}

impl ShaderTrial<'_> {
    /// The names of the shaders.
    pub fn names() -> impl Iterator<Item = &'static str> {
        Shader::ALL.iter().map(|shader| shader.name())
    }

    /// The number of rows that a workgroup sized for an adapter transforms together.
    ///
    /// # Errors
    /// [`GpuError::TransformSize`] if the adapter cannot transform planes of `nx` columns and `ny`
    /// rows.
    pub fn row_lines((nx, ny): (usize, usize), adapter: &Adapter) -> Result<usize, GpuError> {
        Ok(PlaneSource::new(nx, ny, adapter)?.rows.lines)
    }

    /// Runs the shader and returns the last buffer after the call. Workgroups are sized for
    /// `adapter`, which may have lower limits than the device's own.
    ///
    /// # Errors
    /// [`GpuError`] if the GPU cannot execute the call.
    ///
    /// # Panics
    /// If the name is not a shader's, or if there are no buffers.
    pub fn run(self, device: &GpuDevice, adapter: &Adapter) -> Result<Vec<f32>, GpuError> {
        let shader = Shader::ALL.iter().find(|shader| shader.name() == self.name);
        let shader = *shader.expect("the name of a shader");
        let source = PlaneSource::new(self.planes.0, self.planes.1, adapter)?;
        let device = &device.attempt()?;
        let mut roots = if shader.is_of_columns() {
            source.column_roots()
        } else {
            source.row_roots()
        };
        if self.spoilt {
            roots[1] = [roots[1][0], -roots[1][1]];
        }
        let groups = match shader {
            Shader::DrawStamps => self.highest.div_ceil(STRIP as u32),
            _ if shader.is_of_columns() => source.column_groups(),
            _ => source.row_groups(),
        };
        let pipelines = device.pipelines(source)?;
        let filled = |words: &Option<Vec<u32>>| match words {
            Some(words) => device.filled("given", words),
            None => device.filled("roots", cast_slice(roots.as_flattened())),
        };
        let buffers: Vec<wgpu::Buffer> = self.buffers.iter().map(filled).collect();
        let mut memory = params_buffer();
        let mut encoder = device.encoder();
        let mut calls = Calls::new(device, &pipelines, &mut memory, 1, &mut encoder, None);
        let bound: Vec<&wgpu::Buffer> = buffers.iter().collect();
        calls.add(shader, self.params, &bound, (groups, self.count));
        calls.end();
        let length = self.buffers.last().and_then(Option::as_ref).map_or(0, Vec::len);
        let bytes = 4 * length as u64;
        let read = Readback::new().with_room(device, bytes);
        encoder.copy_buffer_to_buffer(bound[bound.len() - 1], 0, &read.0, 0, Some(bytes));
        let submission = device.queue().submit([encoder.finish()]);
        InFlight::new(bytes, Marks::default(), read, submission)
            .read(device, |_, values, _| cast_slice(values).to_vec())
    }
}
