//! Buffers on a GPU, and buffers for copies between it and the host.

use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Mutex, PoisonError};

use super::device::{Attempt, GpuDevice};
use super::stopwatch::{self, Marks};
use crate::error::GpuError;

/// The usages of buffers that shaders access.
pub(super) const STORAGE: wgpu::BufferUsages = wgpu::BufferUsages::STORAGE
    .union(wgpu::BufferUsages::COPY_DST)
    .union(wgpu::BufferUsages::COPY_SRC);

impl GpuDevice {
    /// A buffer of at least `bytes`, and at least 16 bytes, with undefined content. Only
    /// [`Attempt::check`] tells whether there was memory for it.
    pub(super) fn buffer(&self, label: &str, bytes: u64, usage: wgpu::BufferUsages) -> wgpu::Buffer {
        self.device().create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size: bytes.next_multiple_of(16).max(16),
            usage,
            mapped_at_creation: false,
        })
    }

    /// Returns an empty list of commands.
    pub(super) fn encoder(&self) -> wgpu::CommandEncoder {
        self.device()
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default())
    }

    /// A buffer filled with 32-bit words.
    pub(super) fn filled(&self, label: &str, words: &[u32]) -> wgpu::Buffer {
        let buffer = self.buffer(label, 4 * words.len() as u64, STORAGE);
        if !words.is_empty() {
            self.queue()
                .write_buffer(&buffer, 0, pulp::bytemuck::cast_slice(words));
        }
        buffer
    }
}

/// A buffer that grows when more bytes are needed.
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

    /// Returns the buffer, with room for `bytes`. If the buffer is too small, a new one replaces
    /// it, and the content is lost.
    pub(super) fn with_room(&mut self, device: &GpuDevice, bytes: u64) -> wgpu::Buffer {
        if self.buffer.as_ref().is_none_or(|buffer| buffer.size() < bytes) {
            self.buffer = Some(device.buffer(self.label, bytes, self.usage));
        }
        self.buffer.clone().expect("made above")
    }
}

/// Mapped buffers for copies to the GPU. Each can be used again when the GPU has copied from it.
#[derive(Debug)]
pub(super) struct Staging {
    free: Vec<wgpu::Buffer>,
    sender: Sender<wgpu::Buffer>,
    receiver: Mutex<Receiver<wgpu::Buffer>>,
}

impl Staging {
    pub(super) fn new() -> Self {
        let (sender, receiver) = channel();
        Self {
            free: Vec::new(),
            sender,
            receiver: Mutex::new(receiver),
        }
    }

    /// Returns a mapped buffer of at least `bytes`.
    pub(super) fn take(&mut self, device: &GpuDevice, bytes: u64) -> wgpu::Buffer {
        let receiver = self.receiver.get_mut().unwrap_or_else(PoisonError::into_inner);
        self.free.extend(receiver.try_iter());
        // Takes the smallest buffer that is large enough.
        let fitting = self
            .free
            .iter()
            .enumerate()
            .filter(|(_, buffer)| buffer.size() >= bytes);
        if let Some((place, _)) = fitting.min_by_key(|(_, buffer)| buffer.size()) {
            return self.free.swap_remove(place);
        }
        // All free buffers are too small.
        if self.free.len() > KEPT {
            self.free.swap_remove(0);
        }
        device.device().create_buffer(&wgpu::BufferDescriptor {
            label: Some("staging"),
            size: bytes.next_multiple_of(ROUNDING),
            usage: wgpu::BufferUsages::MAP_WRITE | wgpu::BufferUsages::COPY_SRC,
            mapped_at_creation: true,
        })
    }

    /// Takes back an unmapped buffer. It is mapped again when the GPU has copied from it.
    pub(super) fn give_back(&self, buffer: wgpu::Buffer) {
        let sender = self.sender.clone();
        let returned = buffer.clone();
        buffer.slice(..).map_async(wgpu::MapMode::Write, move |mapped| {
            if mapped.is_ok() {
                // Sending fails only if the receiver was dropped with this `Staging`. Nothing needs
                // the buffer then.
                let _ = sender.send(returned);
            }
        });
    }
}

/// If more free buffers than this are all too small, one of them is dropped.
const KEPT: usize = 16;
/// The size of a staging buffer is a multiple of this, so that the buffer also fits slightly more
/// light.
const ROUNDING: u64 = 1 << 16;

/// A buffer from which the host reads a panel's result, and one from which it reads the panel's
/// time marks.
#[derive(Debug)]
pub(super) struct Readback {
    pub(super) values: Growing,
    pub(super) marks: Growing,
}

/// A panel that the GPU is computing.
#[derive(Debug)]
pub(super) struct InFlight {
    /// Bytes of the result.
    bytes: u64,
    pub(super) marks: Marks,
    values: wgpu::Buffer,
    stopwatch: wgpu::Buffer,
    submission: wgpu::SubmissionIndex,
    mapped: Receiver<Result<(), wgpu::BufferAsyncError>>,
}

const READ: wgpu::BufferUsages = wgpu::BufferUsages::MAP_READ.union(wgpu::BufferUsages::COPY_DST);

impl Readback {
    pub(super) fn new() -> Self {
        Self {
            values: Growing::new("result", READ),
            marks: Growing::new("marks", READ),
        }
    }

    /// Returns the buffers, with room for `bytes` of the result.
    pub(super) fn with_room(&mut self, device: &GpuDevice, bytes: u64) -> (wgpu::Buffer, wgpu::Buffer) {
        (
            self.values.with_room(device, bytes),
            self.marks.with_room(device, stopwatch::BYTES),
        )
    }
}

impl InFlight {
    /// Asks the driver to map the result and the time marks when the submission is done, so that
    /// the host can read them.
    pub(super) fn new(
        bytes: u64,
        marks: Marks,
        (values, stopwatch): (wgpu::Buffer, wgpu::Buffer),
        submission: wgpu::SubmissionIndex,
    ) -> Self {
        let (sender, mapped) = channel();
        for (buffer, length) in [(&values, bytes), (&stopwatch, stopwatch::BYTES)] {
            let sender = sender.clone();
            buffer
                .slice(..length)
                .map_async(wgpu::MapMode::Read, move |result| {
                    // Sending fails only if the receiver is gone: an error stopped the host before.
                    let _ = sender.send(result);
                });
        }
        Self {
            bytes,
            marks,
            values,
            stopwatch,
            submission,
            mapped,
        }
    }

    /// Waits for the GPU and passes the bytes of the result and of the time marks to `read`.
    pub(super) fn read<R>(
        self,
        device: &Attempt,
        read: impl FnOnce(&Self, &[u8], &[u8]) -> R,
    ) -> Result<R, GpuError> {
        device.wait(self.submission.clone())?;
        for _ in 0..2 {
            // If another thread polls the device, that thread may report the mapping a little
            // later.
            let mapped = self.mapped.recv();
            let mapped = mapped.map_err(|_| device.failed(&"the result was not received"))?;
            mapped.map_err(|error| device.failed(&error))?;
        }
        let values = self.values.slice(..self.bytes).get_mapped_range();
        let values = values.map_err(|error| device.failed(&error))?;
        let marks = self.stopwatch.slice(..stopwatch::BYTES).get_mapped_range();
        let marks = marks.map_err(|error| device.failed(&error))?;
        let result = read(&self, &values, &marks);
        drop((values, marks));
        self.values.unmap();
        self.stopwatch.unmap();
        Ok(result)
    }
}
