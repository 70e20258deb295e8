//! Where the time goes, by the GPU's own clock.

use std::time::Duration;

use super::device::GpuDevice;

/// How long the parts of an execution took. What the host does overlaps with the rest, so that the sum may be more than the whole.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct GpuTimes {
    /// From the light in the host's memory to the image there.
    pub total: Duration,
    /// Shaders, by the GPU's own clock. None where it has none that can be read.
    pub kernels: Option<Duration>,
    /// Copies of the light to the GPU's memory and of the image from it, by the GPU's own clock. None where it has none that can be read.
    pub transfers: Option<Duration>,
    /// What the host did meanwhile: looking at the light and handing it over, adding the result to the image.
    pub host: Duration,
    /// Bytes copied to the GPU, and from it.
    pub bytes: (u64, u64),
}

/// Marks in the work of a panel, and where they are read.
#[derive(Debug)]
pub(super) struct Stopwatch {
    marks: wgpu::QuerySet,
    resolved: wgpu::Buffer,
    /// Nanoseconds of a tick.
    tick: f32,
}

/// Marks that were set, and what lies between pairs of them.
#[derive(Debug, Default)]
pub(super) struct Marks {
    count: u32,
    /// There were too many: what is there is not all.
    incomplete: bool,
    kernels: Vec<(u32, u32)>,
    transfers: Vec<(u32, u32)>,
}

/// Marks of a panel at most.
const MARKS: u32 = 2048;
pub(super) const BYTES: u64 = 8 * MARKS as u64;

impl Stopwatch {
    /// A stopwatch, where the GPU has a clock that can be read.
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

    /// Does some copies, between two marks where there is a stopwatch.
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

    /// How long shaders and copies took, from the bytes of the marks; nothing where there were too many.
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
