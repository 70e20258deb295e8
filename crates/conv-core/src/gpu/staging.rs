//! Buffers that the host fills, and from which the GPU copies.

use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Mutex, PoisonError};

use super::device::GpuDevice;

/// Mapped buffers that come back once the GPU has copied from them.
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

    /// A mapped buffer of at least so many bytes.
    pub(super) fn take(&mut self, device: &GpuDevice, bytes: u64) -> wgpu::Buffer {
        let receiver = self.receiver.get_mut().unwrap_or_else(PoisonError::into_inner);
        self.free.extend(receiver.try_iter());
        // The smallest that suffices.
        let fitting = self
            .free
            .iter()
            .enumerate()
            .filter(|(_, buffer)| buffer.size() >= bytes);
        if let Some((place, _)) = fitting.min_by_key(|(_, buffer)| buffer.size()) {
            return self.free.swap_remove(place);
        }
        // One that is too small will not be asked for again soon.
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

    /// Takes back a buffer whose copies have been submitted.
    pub(super) fn give_back(&self, buffer: wgpu::Buffer) {
        let sender = self.sender.clone();
        let returned = buffer.clone();
        buffer.slice(..).map_async(wgpu::MapMode::Write, move |mapped| {
            if mapped.is_ok() {
                // Nobody listens any more where the engine is gone.
                let _ = sender.send(returned);
            }
        });
    }
}

/// Buffers that wait to be used again at most.
const KEPT: usize = 16;
/// Sizes are multiples of this, so that buffers serve again.
const ROUNDING: u64 = 1 << 16;
