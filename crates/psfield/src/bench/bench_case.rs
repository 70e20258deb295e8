//! What is convolved.

use psf_types::{PsfModelRecord, Scene};

/// A model and the scene that every contender convolves with it.
#[derive(Debug, Clone)]
pub struct BenchCase<T> {
    record: PsfModelRecord,
    scene: Scene<T>,
}

impl<T> BenchCase<T> {
    /// A model, with stamps at the frame's pixels, and a scene.
    pub fn new(record: PsfModelRecord, scene: Scene<T>) -> Self {
        Self { record, scene }
    }

    /// The model.
    pub fn record(&self) -> &PsfModelRecord {
        &self.record
    }

    /// The scene.
    pub fn scene(&self) -> &Scene<T> {
        &self.scene
    }
}
