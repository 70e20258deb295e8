//! Shaders one after the other.

use super::buffers::Growing;
use super::device::GpuDevice;
use super::pipelines::Pipelines;
use super::shader::Shader;
use super::words::Params;

/// What shaders are called with, collected to be handed over at once.
#[derive(Debug)]
pub(super) struct Calls<'a> {
    device: &'a GpuDevice,
    pipelines: &'a Pipelines,
    params: wgpu::Buffer,
    /// Bytes of the parameters, each call's at an offset that the adapter allows.
    bytes: Vec<u8>,
    step: usize,
    list: Vec<Call>,
}

#[derive(Debug)]
struct Call {
    shader: Shader,
    bindings: wgpu::BindGroup,
    groups: (u32, u32),
}

/// Bytes of a call's parameters.
const PARAM_BYTES: u64 = 32;

/// The buffer that parameters go to.
pub(super) fn params_buffer() -> Growing {
    Growing::new(
        "parameters",
        wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
    )
}

impl<'a> Calls<'a> {
    /// For at most `most` calls.
    pub(super) fn new(
        device: &'a GpuDevice,
        pipelines: &'a Pipelines,
        params: &mut Growing,
        most: usize,
    ) -> Self {
        let step = device.device().limits().min_uniform_buffer_offset_alignment as usize;
        let step = step.max(PARAM_BYTES as usize);
        Self {
            device,
            pipelines,
            params: params.with_room(device, (most * step) as u64).clone(),
            bytes: Vec::with_capacity(most * step),
            step,
            list: Vec::with_capacity(most),
        }
    }

    /// Adds a call of some workgroups; buffers are bound in the order of the shader's bindings, parameters first.
    pub(super) fn add(
        &mut self,
        shader: Shader,
        params: Params,
        buffers: &[&wgpu::Buffer],
        groups: (u32, u32),
    ) {
        if groups.0 == 0 || groups.1 == 0 {
            return;
        }
        let offset = self.bytes.len() as u64;
        for word in params.words() {
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
        let layout = self.pipelines.get(shader).get_bind_group_layout(0);
        let bindings = self
            .device
            .device()
            .create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some(shader.name()),
                layout: &layout,
                entries: &entries,
            });
        self.list.push(Call {
            shader,
            bindings,
            groups,
        });
    }

    /// Hands the parameters over, to be there before whatever is submitted next, and writes the calls down.
    pub(super) fn encode(
        self,
        encoder: &mut wgpu::CommandEncoder,
        marks: Option<wgpu::ComputePassTimestampWrites<'_>>,
    ) {
        self.device.queue().write_buffer(&self.params, 0, &self.bytes);
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("shaders"),
            timestamp_writes: marks,
        });
        for call in &self.list {
            pass.set_pipeline(self.pipelines.get(call.shader));
            pass.set_bind_group(0, &call.bindings, &[]);
            pass.dispatch_workgroups(call.groups.0, call.groups.1, 1);
        }
    }
}
