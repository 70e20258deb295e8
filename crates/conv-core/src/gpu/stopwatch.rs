//! Measurement of time by the GPU's own clock.

use std::time::Duration;

use super::device::GpuDevice;

/// The durations of the parts of an execution, and the bytes copied. The host works at the same
/// time as the GPU, so the sum of the parts may exceed the total.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct GpuTimes {
    /// The whole execution, from light in the host's memory to the image in the host's memory.
    pub total: Duration,
    /// Shaders, by the GPU's own clock. `None` if the GPU has no readable clock, or if there were
    /// more steps than psfield can time.
    pub kernels: Option<Duration>,
    /// Copies of the light to the GPU's memory and of the image from it, by the GPU's own clock.
    /// `None` as for `kernels`.
    pub transfers: Option<Duration>,
    /// Work of the host: inspecting and copying the light, and adding the result to the image.
    pub host: Duration,
    /// Bytes copied to the GPU, and bytes copied from it.
    pub bytes: (u64, u64),
}

/// Time marks in the work of a panel, and the buffer for reading them.
#[derive(Debug)]
pub(super) struct Stopwatch {
    marks: wgpu::QuerySet,
    resolved: wgpu::Buffer,
    /// Nanoseconds per tick.
    tick: f32,
}

/// The number of time marks that were set, and the pairs of marks that enclose shaders and copies.
#[derive(Debug, Default)]
pub(super) struct Marks {
    count: u32,
    /// True if some marks were not set, because there were too many.
    incomplete: bool,
    kernels: Vec<(u32, u32)>,
    transfers: Vec<(u32, u32)>,
}

/// The most marks of a panel.
const MARKS: u32 = 2048;
pub(super) const BYTES: u64 = 8 * MARKS as u64;

impl Stopwatch {
    /// Returns a stopwatch if the GPU has a readable clock.
    pub(super) fn new(device: &GpuDevice) -> Option<Self> {
        if !device.adapter().timestamps {
            return None;
        }
        Some(Self {
            marks: device.device().create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("stopwatch"),
                ty: wgpu::QueryType::Timestamp,
                count: MARKS,
            }),
            resolved: device.buffer(
                "stopwatch",
                BYTES,
                wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC,
            ),
            tick: device.queue().get_timestamp_period(),
        })
    }

    /// Marks for the beginning and the end of a pass of shaders, unless there are too many.
    pub(super) fn kernels(&self, marks: &mut Marks) -> Option<wgpu::ComputePassTimestampWrites<'_>> {
        let pair = Self::pair(marks)?;
        marks.kernels.push(pair);
        Some(wgpu::ComputePassTimestampWrites {
            query_set: &self.marks,
            beginning_of_pass_write_index: Some(pair.0),
            end_of_pass_write_index: Some(pair.1),
        })
    }

    /// Runs `copies`. If there is a stopwatch, sets a time mark before and after them, unless there
    /// are too many marks.
    pub(super) fn transfers(
        stopwatch: Option<&Self>,
        marks: &mut Marks,
        encoder: &mut wgpu::CommandEncoder,
        copies: impl FnOnce(&mut wgpu::CommandEncoder),
    ) {
        let pair = stopwatch.and_then(|stopwatch| Some((stopwatch, Self::pair(marks)?)));
        if let Some((stopwatch, pair)) = pair {
            encoder.write_timestamp(&stopwatch.marks, pair.0);
        }
        copies(encoder);
        if let Some((stopwatch, pair)) = pair {
            encoder.write_timestamp(&stopwatch.marks, pair.1);
            marks.transfers.push(pair);
        }
    }

    fn pair(marks: &mut Marks) -> Option<(u32, u32)> {
        let pair = (marks.count, marks.count + 1);
        if pair.1 >= MARKS {
            marks.incomplete = true;
            return None;
        }
        marks.count += 2;
        Some(pair)
    }

    /// Copies the marks into a buffer that the host can read.
    pub(super) fn read(&self, marks: &Marks, encoder: &mut wgpu::CommandEncoder, into: &wgpu::Buffer) {
        if marks.count > 0 {
            encoder.resolve_query_set(&self.marks, 0..marks.count, &self.resolved, 0);
            encoder.copy_buffer_to_buffer(&self.resolved, 0, into, 0, Some(8 * u64::from(marks.count)));
        }
    }

    /// Returns the durations of shaders and of copies from the bytes of the marks. Returns `None`
    /// if there were too many marks.
    pub(super) fn durations(&self, marks: &Marks, bytes: &[u8]) -> Option<(Duration, Duration)> {
        if marks.incomplete {
            return None;
        }
        let ticks: Vec<u64> = bytes
            .chunks_exact(8)
            .map(|b| u64::from_le_bytes(b.try_into().expect("eight bytes")))
            .collect();
        let sum = |pairs: &[(u32, u32)]| {
            let ticks: u64 = pairs
                .iter()
                .map(|&(from, to)| ticks[to as usize].saturating_sub(ticks[from as usize]))
                .sum();
            Duration::from_nanos((ticks as f64 * f64::from(self.tick)) as u64)
        };
        Some((sum(&marks.kernels), sum(&marks.transfers)))
    }
}
