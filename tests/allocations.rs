//! What a measurement allocates once its workspace has been used: counted on every thread, by the allocator itself.
//! Without the detector, whose network allocates for itself, and on the threads of a rayon pool, as to hand work to a pool
//! from outside allocates a little now and then. By the points: the dense method solves matrices of no fixed size.

mod common;

use common::{Set, here};
use datum::lent::Spare;
use datum::measure::{Measurement, Measurer, Shared, Verdict};
use datum::{Capture, Image, VehicleFile};
use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

/// The system's allocator, and how often it was asked.
struct Counting;

static CALLS: AtomicUsize = AtomicUsize::new(0);

#[expect(unsafe_code, reason = "an allocator that counts cannot be written without")]
// SAFETY: every call is passed on to the system's allocator as it came.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        CALLS.fetch_add(1, Relaxed);
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        unsafe { System.dealloc(at, layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        CALLS.fetch_add(1, Relaxed);
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, at: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        CALLS.fetch_add(1, Relaxed);
        unsafe { System.realloc(at, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// What `f` gives, and how often it allocated.
fn counted<R>(f: impl FnOnce() -> R) -> (R, usize) {
    let before = CALLS.load(Relaxed);
    let result = f();
    (result, CALLS.load(Relaxed) - before)
}

/// A capture with its images.
struct Loaded {
    capture: Capture,
    red: Image<u16>,
    fringes: Vec<Vec<Image<u16>>>,
}

impl Loaded {
    fn new(set: &Set, name: &str) -> Self {
        let capture = set.capture(name);
        let load = |path: &std::path::PathBuf| capture.load(path).expect("there");
        let red = load(capture.images.red.as_ref().expect("there"));
        let fringes = capture.fringes.iter().map(|set| set.images.iter().map(load).collect()).collect();
        Self { red, fringes, capture }
    }

    fn measured(&self, measurer: &Measurer) -> Measurement {
        let mut cycle = measurer.begin(&self.capture, &self.red, None);
        for (k, set) in self.fringes.iter().enumerate() {
            for (step, image) in (0u32..).zip(set) {
                cycle.add_fringe(k, step, image).expect("of the capture");
            }
        }
        cycle.finish(&mut |_| ()).0
    }
}

#[test]
fn after_the_first_capture_a_measurement_allocates_nothing_but_the_result_it_hands_out() {
    let set = Set::open(here("station"));
    let features = VehicleFile::read(&set.folder.join("features.toml")).expect("features");
    let taught = set.teach("taught", &features);
    let captures = ["moved", "taught"].map(|name| Loaded::new(&set, name));
    for threads in [1, 2, 3] {
        let shared = Shared::default();
        let jobs = ["allocations", "allocations-too"].map(|name| set.measurer(&taught, name).sharing(&shared));
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        // what a thread needs for itself when it first takes part
        pool.broadcast(|_| Spare::default().serve(|| ()));
        pool.install(|| {
            let first = captures.each_ref().map(|capture| capture.measured(&jobs[0]));
            for job in &jobs {
                for (capture, first) in captures.iter().zip(&first) {
                    let (again, calls) = counted(|| capture.measured(job));
                    assert_eq!((first, first.verdict), (&again, Verdict::Ok));
                    // names and lists that whoever asked may keep: as many as a copy of it has
                    let (_copy, of_result) = counted(|| again.clone());
                    eprintln!("{}, {threads} threads: {calls} allocations, {of_result} are the result", again.capture);
                    assert_eq!(calls, of_result, "{} on {threads} threads", again.capture);
                }
            }
        });
    }
}
