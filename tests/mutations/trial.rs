//! Reading of many mutated files by one reader.

use std::io::Write as _;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use crate::{COUNT, memory, mutator};

/// Longest time of a call when many inputs are read at night.
const LONGEST: Duration = Duration::from_secs(5);
/// Longest time of a call otherwise. It only shows that the reader hangs; a busy machine must not fail the test.
const HANGS: Duration = Duration::from_secs(120);
/// Memory of a call: so many times the file, and so many bytes besides.
const TIMES_THE_FILE: usize = 3;
const BYTES_BESIDES: usize = 300_000_000;
/// Failures that are shown.
const SHOWN: usize = 5;

static ALONE: Mutex<()> = Mutex::new(());
/// The input that is being read, for messages of a process that ends.
static INPUT: AtomicU64 = AtomicU64::new(0);
static READER: Mutex<String> = Mutex::new(String::new());

/// A valid file.
pub struct Original {
    pub bytes: Vec<u8>,
    /// What makes a mutated file plausible again, such as its checksums.
    pub finish: fn(Vec<u8>) -> Vec<u8>,
}

impl Original {
    pub fn new(bytes: Vec<u8>) -> Self {
        Self { bytes, finish: |bytes| bytes }
    }
}

/// Returns a lock that one test has at a time, so that memory and times are those of one reader.
pub fn alone() -> MutexGuard<'static, ()> {
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Returns which input is being read.
pub fn place() -> String {
    let reader = READER.try_lock().map(|reader| reader.clone()).unwrap_or_default();
    format!("{reader}, input {}", INPUT.load(Ordering::Relaxed))
}

/// Mutates the originals in turns and reads each result. The closure receives the number of the original and the mutated file, and returns
/// whether the reader accepted it.
pub fn check(reader: &str, originals: &[Original], read: impl Fn(usize, &[u8]) -> bool) {
    let _alone = alone();
    reader.clone_into(&mut READER.lock().unwrap_or_else(PoisonError::into_inner));
    for (number, original) in originals.iter().enumerate() {
        assert!(read(number, &(original.finish)(original.bytes.clone())), "{reader}: original {number} is refused");
    }
    let environment = |name| std::env::var(name).ok().map(|value| value.parse::<u64>().unwrap());
    let (single, count) = (environment("MUTATION"), environment("MUTATIONS"));
    let watch = Watch::start(if count.is_some() { LONGEST } else { HANGS });
    let inputs = single.map_or(0..count.unwrap_or(COUNT), |number| number..number + 1);
    let (mut accepted, mut slowest, mut peak, mut failures) = (0, Duration::ZERO, 0, Vec::new());
    for input in inputs.clone() {
        let number = input as usize % originals.len();
        let original = &originals[number];
        let mut random = ChaCha8Rng::seed_from_u64(input);
        let bytes = (original.finish)(mutator::mutated(&original.bytes, &mut random));
        INPUT.store(input, Ordering::Relaxed);
        watch.begin();
        let begun = Instant::now();
        let (result, bytes_used) = memory::of(|| catch_unwind(AssertUnwindSafe(|| read(number, &bytes))));
        slowest = slowest.max(begun.elapsed());
        peak = peak.max(bytes_used);
        match result {
            Ok(is_accepted) => accepted += u64::from(is_accepted),
            Err(_) => failures.push((input, "panics".to_owned())),
        }
        if bytes_used > TIMES_THE_FILE * bytes.len() + BYTES_BESIDES {
            failures.push((input, format!("needs {} MB for {} bytes", bytes_used / 1_000_000, bytes.len())));
        }
    }
    drop(watch);
    let inputs = inputs.count() as u64;
    let line = serde_json::json!({
        "reader": reader, "inputs": inputs, "accepted": accepted, "refused": inputs - accepted - failures.len() as u64,
        "failures": failures.len(), "slowest_s": slowest.as_secs_f64(), "peak_mb": peak as f64 / 1e6,
    });
    eprintln!("{line}");
    if let Some(path) = std::env::var_os("MUTATIONS_OUT") {
        let mut file = std::fs::OpenOptions::new().create(true).append(true).open(path).unwrap();
        writeln!(file, "{line}").unwrap();
    }
    assert!(
        failures.is_empty(),
        "{reader}: {} inputs, such as {:?}; read one again with MUTATION=NUMBER cargo test --test mutations {reader}",
        failures.len(),
        &failures[..failures.len().min(SHOWN)]
    );
}

/// Thread that ends the process if a call takes too long.
struct Watch {
    shared: Arc<(Mutex<Instant>, Condvar, AtomicBool)>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Watch {
    fn start(limit: Duration) -> Self {
        let shared = Arc::new((Mutex::new(Instant::now()), Condvar::new(), AtomicBool::new(false)));
        let watched = Arc::clone(&shared);
        let watch = move || {
            let (begun, changed, is_done) = &*watched;
            let mut begun = begun.lock().unwrap_or_else(PoisonError::into_inner);
            while !is_done.load(Ordering::Relaxed) {
                if begun.elapsed() > limit {
                    let _ = writeln!(std::io::stderr(), "more than {} s, at {}", limit.as_secs(), place());
                    std::process::abort();
                }
                (begun, _) = changed.wait_timeout(begun, limit / 10).unwrap_or_else(PoisonError::into_inner);
            }
        };
        Self { shared, thread: Some(std::thread::spawn(watch)) }
    }

    /// A call begins.
    fn begin(&self) {
        *self.shared.0.lock().unwrap_or_else(PoisonError::into_inner) = Instant::now();
    }
}

impl Drop for Watch {
    fn drop(&mut self) {
        self.shared.2.store(true, Ordering::Relaxed);
        self.shared.1.notify_all();
        let _ = self.thread.take().map(std::thread::JoinHandle::join);
    }
}
