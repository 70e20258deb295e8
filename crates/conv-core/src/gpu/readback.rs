//! Results on their way to the host.

use std::sync::mpsc::{Receiver, channel};

use super::buffers::Growing;
use super::device::{Attempt, GpuDevice};
use super::error::GpuError;
use super::panels::Rectangle;
use super::stopwatch::{self, Marks};

/// A buffer for a panel's result, and one for the marks of its stopwatch.
#[derive(Debug)]
pub(super) struct Readback {
    pub(super) values: Growing,
    pub(super) marks: Growing,
}

/// A panel that the GPU works on.
#[derive(Debug)]
pub(super) struct InFlight {
    pub(super) output: Rectangle,
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

    /// The buffers, with room for some bytes of result.
    pub(super) fn with_room(&mut self, device: &GpuDevice, bytes: u64) -> (wgpu::Buffer, wgpu::Buffer) {
        (
            self.values.with_room(device, bytes).clone(),
            self.marks.with_room(device, stopwatch::BYTES).clone(),
        )
    }
}

impl InFlight {
    /// Asks for what was submitted to be readable once it is done.
    pub(super) fn new(
        output: Rectangle,
        marks: Marks,
        (values, stopwatch): (wgpu::Buffer, wgpu::Buffer),
        submission: wgpu::SubmissionIndex,
    ) -> Self {
        let (sender, mapped) = channel();
        for (buffer, length) in [(&values, output.bytes()), (&stopwatch, stopwatch::BYTES)] {
            let sender = sender.clone();
            buffer
                .slice(..length)
                .map_async(wgpu::MapMode::Read, move |result| {
                    // Nobody listens any more after an error.
                    let _ = sender.send(result);
                });
        }
        Self {
            output,
            marks,
            values,
            stopwatch,
            submission,
            mapped,
        }
    }

    /// Waits for the GPU and shows the result's bytes and the stopwatch's.
    pub(super) fn read<R>(
        self,
        device: &Attempt,
        read: impl FnOnce(&Self, &[u8], &[u8]) -> R,
    ) -> Result<R, GpuError> {
        device.wait(self.submission.clone())?;
        for _ in 0..2 {
            // Another thread may be the one that passes the news on, a little later.
            let mapped = self.mapped.recv();
            let mapped = mapped.map_err(|_| device.failed(&"the result did not come"))?;
            mapped.map_err(|error| device.failed(&error))?;
        }
        let values = self.values.slice(..self.output.bytes()).get_mapped_range();
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
