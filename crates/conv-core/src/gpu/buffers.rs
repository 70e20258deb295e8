//! Buffers on a GPU and between it and the host.

use super::device::GpuDevice;

/// What shaders see.
pub(super) const STORAGE: wgpu::BufferUsages = wgpu::BufferUsages::STORAGE
    .union(wgpu::BufferUsages::COPY_DST)
    .union(wgpu::BufferUsages::COPY_SRC);

impl GpuDevice {
    /// A buffer of at least a word, whose contents are undefined. Only [`check`](Self::check) tells whether there was room for it.
    pub(super) fn buffer(&self, label: &str, bytes: u64, usage: wgpu::BufferUsages) -> wgpu::Buffer {
        self.device().create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size: bytes.next_multiple_of(16).max(16),
            usage,
            mapped_at_creation: false,
        })
    }

    /// A list of commands to be submitted.
    pub(super) fn encoder(&self) -> wgpu::CommandEncoder {
        self.device()
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default())
    }

    /// A buffer of words.
    pub(super) fn filled(&self, label: &str, words: &[u32]) -> wgpu::Buffer {
        let buffer = self.buffer(label, 4 * words.len() as u64, STORAGE);
        if !words.is_empty() {
            self.queue()
                .write_buffer(&buffer, 0, pulp::bytemuck::cast_slice(words));
        }
        buffer
    }
}

/// A buffer that grows with what it is asked to hold.
#[derive(Debug)]
pub(super) struct Growing {
    label: &'static str,
    usage: wgpu::BufferUsages,
    buffer: Option<wgpu::Buffer>,
}

impl Growing {
    pub(super) fn new(label: &'static str, usage: wgpu::BufferUsages) -> Self {
        Self {
            label,
            usage,
            buffer: None,
        }
    }

    /// The buffer, with room for some bytes; what it holds is undefined.
    pub(super) fn with_room(&mut self, device: &GpuDevice, bytes: u64) -> &wgpu::Buffer {
        if self.buffer.as_ref().is_none_or(|buffer| buffer.size() < bytes) {
            self.buffer = Some(device.buffer(self.label, bytes, self.usage));
        }
        self.buffer.as_ref().expect("made above")
    }
}
