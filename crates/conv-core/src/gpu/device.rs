//! An open GPU, and its compiled shaders.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use pulp::bytemuck::cast_slice;

use super::adapter::{Adapter, TIMESTAMPS, choose};
use super::plane_source::PlaneSource;
use super::shader::Shader;
use crate::error::GpuError;

/// A GPU that plans can run on. Cheap to clone: clones share the GPU.
///
/// ```
/// use conv_core::gpu::{GpuDevice, GpuError};
/// match GpuDevice::new(None) {
///     Ok(gpu) => println!("on {}", gpu.adapter()),
///     Err(GpuError::NoAdapter) => println!("no GPU here"),
///     Err(error) => return Err(error.into()),
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct GpuDevice(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    adapter: Adapter,
    device: wgpu::Device,
    queue: wgpu::Queue,
    trouble: Arc<Mutex<Trouble>>,
    /// Compiled shaders: one entry for each size of the planes (the arrays that shaders transform).
    pipelines: Mutex<Vec<Arc<Pipelines>>>,
}

/// Errors reported by the driver.
#[derive(Debug, Default)]
struct Trouble {
    /// Why the GPU was lost, if it was.
    lost: Option<String>,
    /// The number of times that the GPU's memory was full.
    out_of_memory: u64,
    /// The number of other errors.
    complaints: u64,
    /// The message of the last other error.
    last: String,
}

/// Work on a GPU. It fails with any error that the driver reports after the work began, and if the
/// GPU was lost before. Several attempts may use the GPU at the same time. An error then makes all
/// of them fail, because the driver does not report which work caused the error.
#[derive(Debug)]
pub(super) struct Attempt {
    device: GpuDevice,
    /// Errors before the work began: the number of times that memory was full, and the number of
    /// other errors.
    before: (u64, u64),
}

impl GpuDevice {
    /// Opens the preferred adapter or, if `name` is given, the first adapter that matches it. A
    /// name matches if it is a part of the adapter's name, or is the adapter's backend. Upper and
    /// lower case are equal. Discrete GPUs are preferred to integrated ones, and software is last.
    ///
    /// # Errors
    /// [`GpuError`] if there is no GPU, if no GPU matches the name, or if the driver cannot open
    /// the GPU.
    pub fn new(name: Option<&str>) -> Result<Self, GpuError> {
        let (adapter, handle) = choose(name)?;
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("psfield"),
            required_features: handle.features() & TIMESTAMPS,
            // Requests the adapter's full limits: they determine the sizes of buffers and
            // workgroups.
            required_limits: handle.limits(),
            memory_hints: wgpu::MemoryHints::Performance,
            ..wgpu::DeviceDescriptor::default()
        };
        let opened = pollster::block_on(handle.request_device(&descriptor));
        let (device, queue) = opened.map_err(|error| GpuError::Unusable {
            adapter: adapter.to_string(),
            reason: error.to_string(),
        })?;
        let trouble = Arc::new(Mutex::new(Trouble::default()));
        let heard = Arc::clone(&trouble);
        device.on_uncaptured_error(Arc::new(move |error| locked(&heard).hear(&error)));
        let heard = Arc::clone(&trouble);
        device.set_device_lost_callback(move |reason, message| {
            let text = if message.is_empty() {
                format!("{reason:?}")
            } else {
                message
            };
            locked(&heard).lost.get_or_insert(text);
        });
        Ok(Self(Arc::new(Inner {
            adapter,
            device,
            queue,
            trouble,
            pipelines: Mutex::new(Vec::new()),
        })))
    }

    /// The adapter.
    pub fn adapter(&self) -> &Adapter {
        &self.0.adapter
    }

    /// Tells the driver to close the GPU. Any later use returns [`GpuError::Lost`].
    pub fn close(&self) {
        self.0.device.destroy();
        self.lose("it was closed");
    }

    /// Marks the GPU as lost. A reason that is already known stays.
    fn lose(&self, reason: &str) {
        let lost = &mut locked(&self.0.trouble).lost;
        lost.get_or_insert_with(|| reason.to_owned());
    }

    pub(super) fn device(&self) -> &wgpu::Device {
        &self.0.device
    }

    pub(super) fn queue(&self) -> &wgpu::Queue {
        &self.0.queue
    }

    /// Begins to use the GPU.
    pub(super) fn attempt(&self) -> Result<Attempt, GpuError> {
        let attempt = Attempt {
            device: self.clone(),
            before: locked(&self.0.trouble).so_far(),
        };
        attempt.check()?;
        Ok(attempt)
    }
}

impl std::ops::Deref for Attempt {
    type Target = GpuDevice;
    fn deref(&self) -> &GpuDevice {
        &self.device
    }
}

impl Attempt {
    /// Returns an error if the driver has reported one since the work began, or if the GPU is lost.
    pub(super) fn check(&self) -> Result<(), GpuError> {
        let adapter = &self.device.adapter().name;
        locked(&self.device.0.trouble).since(self.before, adapter)
    }

    /// Waits for a submission to finish.
    pub(super) fn wait(&self, submission: wgpu::SubmissionIndex) -> Result<(), GpuError> {
        let device = self.device.device();
        // wgpu panics if the GPU is lost during the wait. The panic is still printed on standard
        // error.
        let waited = catch_unwind(AssertUnwindSafe(|| {
            device.poll(wgpu::PollType::Wait {
                submission_index: Some(submission),
                timeout: None,
            })
        }));
        let Ok(waited) = waited else {
            self.device.lose("it no longer responds");
            return self.check();
        };
        self.check()?;
        waited.map(drop).map_err(|error| self.failed(&error))
    }

    /// Returns the error that [`check`](Self::check) finds. If it finds none, returns an error with
    /// `reason`.
    pub(super) fn failed(&self, reason: &dyn std::fmt::Display) -> GpuError {
        self.check().err().unwrap_or_else(|| GpuError::Driver {
            adapter: self.device.adapter().name.clone(),
            reason: reason.to_string(),
        })
    }

    /// Returns the compiled shaders for the planes of `source`. The device keeps them, because the
    /// driver takes long to compile them.
    pub(super) fn pipelines(&self, source: PlaneSource) -> Result<Arc<Pipelines>, GpuError> {
        let mut made = locked(&self.device.0.pipelines);
        if let Some(found) = made.iter().find(|pipelines| pipelines.source == source) {
            return Ok(Arc::clone(found));
        }
        let new = Pipelines::new(self, source)?;
        made.push(Arc::clone(&new));
        Ok(new)
    }

    /// Continues after an error: ignores the errors up to now, except the loss of the GPU.
    pub(super) fn forgive(&mut self) {
        self.before = locked(&self.device.0.trouble).so_far();
    }
}

impl Trouble {
    fn hear(&mut self, error: &wgpu::Error) {
        if let wgpu::Error::OutOfMemory { .. } = error {
            self.out_of_memory += 1;
        } else {
            self.complaints += 1;
            self.last = error.to_string();
        }
    }

    fn so_far(&self) -> (u64, u64) {
        (self.out_of_memory, self.complaints)
    }

    /// Returns an error if the GPU is lost, or if the driver has reported errors since the counts
    /// were `before`.
    fn since(&self, before: (u64, u64), adapter: &str) -> Result<(), GpuError> {
        let adapter = adapter.to_owned();
        // wgpu closes a device that runs out of memory while shaders run. It then reports the lack
        // of memory as the reason of the loss.
        let lost_for_memory = |reason: &String| reason.to_lowercase().contains("out of memory");
        // This test is first, because a failed allocation causes other errors.
        if self.out_of_memory > before.0 || self.lost.as_ref().is_some_and(lost_for_memory) {
            return Err(GpuError::OutOfMemory { adapter });
        }
        if let Some(reason) = &self.lost {
            let reason = reason.clone();
            return Err(GpuError::Lost { adapter, reason });
        }
        if self.complaints > before.1 {
            let reason = self.last.clone();
            return Err(GpuError::Driver { adapter, reason });
        }
        Ok(())
    }
}

/// Locks a mutex. Ignores poisoning: a panic of another thread does not make the data invalid.
pub(super) fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The compiled shaders for one size of planes, and their roots of unity.
#[derive(Debug)]
pub(super) struct Pipelines {
    pub(super) source: PlaneSource,
    /// One pipeline per shader, in the order of [`Shader::ALL`], which is also the order of the
    /// enum.
    of_shaders: [wgpu::ComputePipeline; Shader::ALL.len()],
    pub(super) row_roots: wgpu::Buffer,
    pub(super) column_roots: wgpu::Buffer,
}

impl Pipelines {
    pub(super) fn new(device: &Attempt, source: PlaneSource) -> Result<Arc<Self>, GpuError> {
        // Starts new threads instead of using rayon's. While the caller waited for rayon's threads,
        // it could begin other work of the pool. That work could wait for the lock of the
        // pipelines, which the caller holds.
        let of_shaders = std::thread::scope(|scope| {
            let made = Shader::ALL.map(|shader| {
                let source = &source;
                scope.spawn(move || pipeline(device, source, shader))
            });
            made.map(|thread| thread.join().expect("compilation does not panic"))
        });
        let row_roots = device.filled("row roots", cast_slice(source.row_roots().as_flattened()));
        let column_roots = device.filled("column roots", cast_slice(source.column_roots().as_flattened()));
        device.check()?;
        Ok(Arc::new(Self {
            source,
            of_shaders,
            row_roots,
            column_roots,
        }))
    }

    pub(super) fn get(&self, shader: Shader) -> &wgpu::ComputePipeline {
        &self.of_shaders[shader as usize]
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
            // Shaders write every value of this memory before they read it.
            zero_initialize_workgroup_memory: false,
            ..wgpu::PipelineCompilationOptions::default()
        },
        cache: None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn complaints_count_from_the_beginning_of_an_attempt_and_a_loss_for_good() {
        let adapter = || "a".to_owned();
        let broken = Err(GpuError::Driver {
            adapter: adapter(),
            reason: "broken".into(),
        });
        let full = Err(GpuError::OutOfMemory { adapter: adapter() });
        let mut trouble = Trouble::default();
        let first = trouble.so_far();
        assert_eq!(trouble.since(first, "a"), Ok(()));
        trouble.hear(&wgpu::Error::OutOfMemory {
            source: "full".into(),
        });
        let second = trouble.so_far();
        trouble.hear(&wgpu::Error::Internal {
            source: "x".into(),
            description: "broken".into(),
        });
        let third = trouble.so_far();
        // Errors that follow from the lack of memory do not hide it.
        assert_eq!(trouble.since(first, "a"), full);
        assert_eq!(trouble.since(second, "a"), broken);
        assert_eq!(trouble.since(third, "a"), Ok(()));
        trouble.lost = Some("Out of memory".into());
        assert_eq!(trouble.since(third, "a"), full);
        trouble.lost = Some("reset".into());
        let lost = GpuError::Lost {
            adapter: adapter(),
            reason: "reset".into(),
        };
        assert_eq!(trouble.since(third, "a"), Err(lost));
    }
}
