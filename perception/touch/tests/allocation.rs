//! After the first images of a size, inference allocates nothing.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use image::{Rgb, RgbImage};
use mvt_products::Instructions;
use mvt_touch::engine::{Engine, Prediction};
use mvt_touch::network::{Architecture, Weights};

/// Allocator of the system, with a count.
struct Counting;

static COUNT: AtomicUsize = AtomicUsize::new(0);
thread_local!(static OWN: Cell<usize> = const { Cell::new(0) });

// SAFETY: all calls go to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        COUNT.fetch_add(1, Ordering::Relaxed);
        OWN.set(OWN.get() + 1);
        // SAFETY: as promised by the caller.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as promised by the caller.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn nothing_is_allocated_per_frame() {
    for name in Architecture::NAMES {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/fixtures/{name}.safetensors"));
        let weights = Weights::read(&path).unwrap();
        for set in Instructions::available() {
            let engine = Engine::new(&weights, set);
            let (mut prediction, image) = (Prediction::default(), RgbImage::from_pixel(48, 64, Rgb([10, 80, 200])));
            engine.infer(&image, &mut prediction).unwrap();
            let mut passes = || {
                let before = [OWN.get(), COUNT.load(Ordering::Relaxed)];
                for _ in 0..3 {
                    engine.infer(&image, &mut prediction).unwrap();
                }
                [OWN.get() - before[0], COUNT.load(Ordering::Relaxed) - before[1]]
            };
            // The thread of the test harness may allocate once while the first passes run; the engine must not allocate on any thread.
            let tries = [passes(), passes()];
            assert!(tries.iter().all(|[own, _]| *own == 0), "{name} {}: {tries:?}", set.name());
            assert!(tries.iter().any(|[_, all]| *all == 0), "{name} {}: {tries:?}", set.name());
        }
    }
}
