//! What a measurement allocates once its buffers are made: counted on every thread, by the allocator itself.

mod common;

use common::{Set, here};
use datum::measure::{Measurement, Measurer, Shared, Verdict};
use datum::{Image, VehicleFile};
use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

/// What a list of the pixels about a feature grows to here; the maps of a region are larger.
const MOST_AT_ONCE: usize = 4 << 20;

/// The system's allocator; how often it was asked, for how much in all, and for how much at most at once.
struct Counting;

static CALLS: AtomicUsize = AtomicUsize::new(0);
static BYTES: AtomicUsize = AtomicUsize::new(0);
static LARGEST: AtomicUsize = AtomicUsize::new(0);

fn count(bytes: usize) {
    CALLS.fetch_add(1, Relaxed);
    BYTES.fetch_add(bytes, Relaxed);
    LARGEST.fetch_max(bytes, Relaxed);
}

#[expect(unsafe_code, reason = "an allocator that counts cannot be written without")]
// SAFETY: every call is passed on to the system's allocator as it came.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count(layout.size());
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        unsafe { System.dealloc(at, layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        count(layout.size());
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, at: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count(size);
        unsafe { System.realloc(at, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn after_the_first_vehicle_no_buffer_of_the_regions_is_allocated() {
    let set = Set::open(here("station"));
    let features = VehicleFile::read(&set.folder.join("features.toml")).expect("features");
    let (taught, shared) = (set.teach("taught", &features), Shared::default());
    let [measurer, of_another_job] =
        ["allocations", "allocations-too"].map(|name| set.measurer(&taught, name).sharing(&shared));
    let capture = set.capture("moved");
    let load = |path: &std::path::PathBuf| capture.load(path).expect("there");
    let red = load(capture.images.red.as_ref().expect("there"));
    let fringes: Vec<Vec<Image<u16>>> =
        capture.fringes.iter().map(|set| set.images.iter().map(load).collect()).collect();
    let measured = |measurer: &Measurer| -> Measurement {
        let mut cycle = measurer.begin(&capture, &red, None);
        for (k, set) in fringes.iter().enumerate() {
            for (step, image) in (0u32..).zip(set) {
                cycle.add_fringe(k, step, image).expect("of the capture");
            }
        }
        cycle.finish(&mut |_| ()).0
    };
    let first = measured(&measurer);
    let of_first = LARGEST.load(Relaxed);
    assert_eq!(first.verdict, Verdict::Ok, "{}", first.detail);
    for counter in [&CALLS, &BYTES, &LARGEST] {
        counter.store(0, Relaxed);
    }
    let second = measured(&measurer);
    let [calls, bytes, largest] = [&CALLS, &BYTES, &LARGEST].map(|counter| counter.load(Relaxed));
    assert_eq!(first, second);
    eprintln!("{calls} allocations of {bytes} bytes in all, {largest} at most; {of_first} at most before");
    // what remains: lists of pixels and edges about a feature, small matrices
    assert!(largest <= MOST_AT_ONCE, "{largest} bytes at once");
    LARGEST.store(0, Relaxed);
    assert_eq!(first, measured(&of_another_job));
    let largest = LARGEST.load(Relaxed);
    assert!(largest <= MOST_AT_ONCE, "another job of the same station: {largest} bytes at once");
}
