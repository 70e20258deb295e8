//! An open GPU.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::adapter::{Adapter, choose, instance};
use super::error::GpuError;

/// A GPU that plans can run on. Cheap to clone: clones are the same GPU.
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
    /// Held by whoever submits work, so that errors have one owner.
    turn: Mutex<()>,
}

/// What the driver said since it was last asked.
#[derive(Debug, Default)]
struct Trouble {
    lost: Option<String>,
    out_of_memory: bool,
    other: Option<String>,
}

/// Features with which a GPU can tell how long its work took.
pub(super) const TIMESTAMPS: wgpu::Features =
    wgpu::Features::TIMESTAMP_QUERY.union(wgpu::Features::TIMESTAMP_QUERY_INSIDE_ENCODERS);

impl GpuDevice {
    /// Opens the first adapter that answers to a name (a part of its name or its backend, in any case), or the preferred one: a
    /// discrete GPU before an integrated one, and software last.
    ///
    /// # Errors
    /// [`GpuError`] where there is none, or none of that name, or its driver refuses.
    pub fn new(name: Option<&str>) -> Result<Self, GpuError> {
        let (handle, adapter) = choose(&instance(), name).map_err(|present| match name {
            Some(name) if !present.is_empty() => GpuError::NoSuchAdapter {
                wanted: name.to_owned(),
                present,
            },
            _ => GpuError::NoAdapter,
        })?;
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("psfield"),
            required_features: handle.features() & TIMESTAMPS,
            // Whatever it can do: buffers and workgroups are sized by it.
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
            turn: Mutex::new(()),
        })))
    }

    /// The adapter.
    pub fn adapter(&self) -> &Adapter {
        &self.0.adapter
    }

    /// Tells the driver to let go of the GPU: whatever is done with it afterwards is [`GpuError::Lost`].
    pub fn close(&self) {
        self.0.device.destroy();
        locked(&self.0.trouble)
            .lost
            .get_or_insert_with(|| "it was closed".to_owned());
    }

    pub(super) fn device(&self) -> &wgpu::Device {
        &self.0.device
    }

    pub(super) fn queue(&self) -> &wgpu::Queue {
        &self.0.queue
    }

    /// Waits until nobody else uses the GPU. What the driver said before is forgotten, but for its loss.
    pub(super) fn turn(&self) -> MutexGuard<'_, ()> {
        let turn = locked(&self.0.turn);
        let mut trouble = locked(&self.0.trouble);
        trouble.out_of_memory = false;
        trouble.other = None;
        turn
    }

    /// The error that the driver told of, if any.
    pub(super) fn check(&self) -> Result<(), GpuError> {
        let trouble = locked(&self.0.trouble);
        let adapter = self.0.adapter.name.clone();
        if let Some(reason) = &trouble.lost {
            let reason = reason.clone();
            return Err(GpuError::Lost { adapter, reason });
        }
        if trouble.out_of_memory {
            return Err(GpuError::OutOfMemory { adapter });
        }
        match &trouble.other {
            Some(reason) => Err(GpuError::Driver {
                adapter,
                reason: reason.clone(),
            }),
            None => Ok(()),
        }
    }
}

impl Trouble {
    fn hear(&mut self, error: &wgpu::Error) {
        match error {
            wgpu::Error::OutOfMemory { .. } => self.out_of_memory = true,
            other => {
                self.other.get_or_insert_with(|| other.to_string());
            }
        }
    }
}

/// A poisoned lock is only that of a thread that panicked elsewhere.
fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
