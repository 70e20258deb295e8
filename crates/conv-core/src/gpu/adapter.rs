//! Detection and choice of GPUs.

use super::fft_source::FftSource;
use crate::error::GpuError;

/// A GPU (or a driver that runs shaders on the processor) and its capabilities.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct Adapter {
    /// The name that its driver reports.
    pub name: String,
    /// The kind of hardware.
    pub kind: AdapterKind,
    /// The interface through which it is driven: `vulkan`, `metal`, `dx12` or `gl`.
    pub backend: String,
    /// The driver's name and version. Empty if the driver does not report them.
    pub driver: String,
    /// The most bytes that a buffer can have.
    pub largest_buffer: u64,
    /// The most bytes that a shader can access in one buffer. Work is divided into pieces whose
    /// buffers are no larger.
    pub largest_binding: u64,
    /// Bytes of memory that the threads of a workgroup share. This limits the size of transforms.
    pub workgroup_memory: u32,
    /// The most threads of a workgroup.
    pub workgroup_threads: u32,
    /// True if it can measure how long its shaders took.
    pub timestamps: bool,
}

/// Features that a GPU needs to measure how long its work took.
pub(super) const TIMESTAMPS: wgpu::Features =
    wgpu::Features::TIMESTAMP_QUERY.union(wgpu::Features::TIMESTAMP_QUERY_INSIDE_ENCODERS);

/// Kinds of adapters, the preferred kind first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[non_exhaustive]
pub enum AdapterKind {
    /// A card with its own memory.
    Discrete,
    /// A GPU that shares the processor's memory.
    Integrated,
    /// A GPU lent to a virtual machine.
    Virtual,
    /// Hardware of unknown kind.
    Other,
    /// Not a GPU: shaders run on the processor.
    Software,
}

impl AdapterKind {
    fn of(kind: wgpu::DeviceType) -> Self {
        match kind {
            wgpu::DeviceType::DiscreteGpu => Self::Discrete,
            wgpu::DeviceType::IntegratedGpu => Self::Integrated,
            wgpu::DeviceType::VirtualGpu => Self::Virtual,
            wgpu::DeviceType::Other => Self::Other,
            wgpu::DeviceType::Cpu => Self::Software,
        }
    }
}

impl std::fmt::Display for AdapterKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Discrete => "discrete GPU",
            Self::Integrated => "integrated GPU",
            Self::Virtual => "virtual GPU",
            Self::Other => "other hardware",
            Self::Software => "software, not a GPU",
        })
    }
}

impl std::fmt::Display for Adapter {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} ({}, {})", self.name, self.kind, self.backend)
    }
}

impl Adapter {
    fn of(adapter: &wgpu::Adapter) -> Self {
        let (info, limits) = (adapter.get_info(), adapter.limits());
        let driver = [info.driver.as_str(), info.driver_info.as_str()];
        let driver: Vec<&str> = driver.into_iter().filter(|text| !text.is_empty()).collect();
        Self {
            name: info.name,
            kind: AdapterKind::of(info.device_type),
            backend: info.backend.to_str().to_owned(),
            driver: driver.join(" "),
            largest_buffer: limits.max_buffer_size,
            largest_binding: limits.max_storage_buffer_binding_size,
            workgroup_memory: limits.max_compute_workgroup_storage_size,
            workgroup_threads: limits
                .max_compute_invocations_per_workgroup
                .min(limits.max_compute_workgroup_size_x),
            timestamps: adapter.features().contains(TIMESTAMPS),
        }
    }

    /// Bytes of the largest buffer that a shader can access.
    pub(super) fn most_at_once(&self) -> u64 {
        self.largest_binding.min(self.largest_buffer)
    }

    /// Returns an error if `what` needs more bytes than a shader can access at once.
    pub(super) fn fits(&self, what: &'static str, needed: u64) -> Result<(), GpuError> {
        let limit = self.most_at_once();
        if needed <= limit {
            return Ok(());
        }
        Err(GpuError::TooLarge {
            adapter: self.name.clone(),
            what,
            needed,
            limit,
        })
    }

    /// Returns whether a workgroup has enough memory for transforms of planes of `nx` columns and
    /// `ny` rows. Transforms along y have `ny / 2` complex values.
    pub(crate) fn can_transform(&self, nx: usize, ny: usize) -> bool {
        nx.max(ny / 2) <= FftSource::longest(self.workgroup_memory as usize)
    }

    /// Returns whether a name is part of this adapter's name or is its backend. Upper and lower
    /// case are equal.
    fn answers_to(&self, name: &str) -> bool {
        self.name.to_lowercase().contains(&name.to_lowercase()) || self.backend.eq_ignore_ascii_case(name)
    }
}

/// The adapters that can run the engine's shaders, the preferred adapter first.
///
/// ```
/// for adapter in conv_core::gpu::adapters() {
///     println!("{adapter}: {} MiB at once", adapter.largest_binding >> 20);
/// }
/// ```
pub fn adapters() -> Vec<Adapter> {
    open_adapters().into_iter().map(|(adapter, _)| adapter).collect()
}

/// Adapters with their handles, the preferred one first.
fn open_adapters() -> Vec<(Adapter, wgpu::Adapter)> {
    let mut adapters = adapters_of(wgpu::Backends::PRIMARY);
    // OpenGL is used only if no other interface finds an adapter. Its limits are lower, and its
    // libraries print warnings on machines without a screen.
    if adapters.is_empty() {
        adapters = adapters_of(wgpu::Backends::GL);
    }
    // The sort is stable, so adapters of one kind keep the order of the system's list.
    adapters.sort_by_key(|(adapter, _)| adapter.kind);
    adapters
}

/// The most storage buffers that a shader uses.
const BUFFERS: u32 = 6;

fn adapters_of(backends: wgpu::Backends) -> Vec<(Adapter, wgpu::Adapter)> {
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor {
        backends,
        ..wgpu::InstanceDescriptor::new_without_display_handle()
    });
    let found = pollster::block_on(instance.enumerate_adapters(backends));
    let able = found.into_iter().filter(|adapter| {
        let can = adapter.get_downlevel_capabilities().flags;
        can.contains(wgpu::DownlevelFlags::COMPUTE_SHADERS)
            && adapter.limits().max_storage_buffers_per_shader_stage >= BUFFERS
    });
    able.map(|adapter| (Adapter::of(&adapter), adapter)).collect()
}

/// Returns the preferred adapter. If `name` is given, returns the first adapter that matches it. If
/// there is no such adapter, the error names all adapters.
pub(super) fn choose(name: Option<&str>) -> Result<(Adapter, wgpu::Adapter), GpuError> {
    let mut adapters = open_adapters();
    let wanted = adapters
        .iter()
        .position(|(adapter, _)| name.is_none_or(|name| adapter.answers_to(name)));
    match (wanted, name) {
        (Some(index), _) => Ok(adapters.swap_remove(index)),
        (None, Some(name)) if !adapters.is_empty() => Err(GpuError::NoSuchAdapter {
            wanted: name.to_owned(),
            present: adapters.into_iter().map(|(adapter, _)| adapter.name).collect(),
        }),
        _ => Err(GpuError::NoAdapter),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_parts_in_any_case_or_backends() {
        let adapter = Adapter {
            name: "NVIDIA H100 80GB HBM3".into(),
            kind: AdapterKind::Discrete,
            backend: "vulkan".into(),
            driver: String::new(),
            largest_buffer: 1 << 30,
            largest_binding: 128 << 20,
            workgroup_memory: 32 << 10,
            workgroup_threads: 256,
            timestamps: true,
        };
        for name in ["h100", "NVIDIA", "Vulkan", "80gb hbm3"] {
            assert!(adapter.answers_to(name), "{name}");
        }
        for name in ["h200", "gl", "vulkan "] {
            assert!(!adapter.answers_to(name), "{name}");
        }
        assert_eq!(
            adapter.to_string(),
            "NVIDIA H100 80GB HBM3 (discrete GPU, vulkan)"
        );
    }
}
