//! A link in user space between two network namespaces: a frame sent by one end's interface arrives
//! at the other one, is lost, or is delayed. Equivalent to `tc netem`, but from a seed and on
//! kernels without it.

use super::impairment::{Impairment, Queue};
use rig_simulator::random::Random;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use std::{
    io,
    os::fd::AsFd,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};
use tun_rs::{DeviceBuilder, Layer, SyncDevice};

/// What went through since the start.
#[derive(Debug, Default)]
pub struct Traffic {
    /// Frames that came in.
    pub frames: AtomicU64,
    pub bytes: AtomicU64,
    /// Frames that did not come out.
    pub lost: AtomicU64,
}

/// The link; it is pulled out when dropped.
pub struct Link {
    impairment: Arc<Mutex<Impairment>>,
    traffic: Arc<Traffic>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Link {
    /// Creates two Ethernet interfaces with these names in the caller's network namespace and
    /// connects them.
    pub fn new(names: [&str; 2], seed: u64) -> io::Result<Self> {
        let end = |name: &str| -> io::Result<SyncDevice> {
            let device =
                DeviceBuilder::new().name(name).layer(Layer::L2).enable(false).build_sync()?;
            device.set_nonblocking(true)?;
            Ok(device)
        };
        let ends = [end(names[0])?, end(names[1])?];
        let impairment = Arc::<Mutex<Impairment>>::default();
        let traffic = Arc::<Traffic>::default();
        let stop = Arc::<AtomicBool>::default();
        let thread = std::thread::Builder::new().name("link".to_owned()).spawn({
            let (impairment, traffic, stop) =
                (Arc::clone(&impairment), Arc::clone(&traffic), Arc::clone(&stop));
            move || run(&ends, &impairment, &traffic, &stop, Random::fork(seed, "link"))
        })?;
        Ok(Self { impairment, traffic, stop, thread: Some(thread) })
    }

    /// Changes how bad it is, from the next frame on.
    pub fn set(&self, impairment: Impairment) {
        *self.impairment.lock().unwrap_or_else(PoisonError::into_inner) = impairment;
    }

    pub fn traffic(&self) -> &Traffic {
        &self.traffic
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

#[allow(clippy::disallowed_methods, reason = "a link is a device: it lives in real time")]
fn run(
    ends: &[SyncDevice; 2],
    impairment: &Mutex<Impairment>,
    traffic: &Traffic,
    stop: &AtomicBool,
    mut random: Random,
) {
    let began = Instant::now();
    let mut queue = Queue::default();
    let mut buffer = vec![0_u8; 65_536];
    while !stop.load(Ordering::Relaxed) {
        let longest = Duration::from_millis(20);
        let wait =
            queue.next().map_or(longest, |due| due.saturating_sub(began.elapsed()).min(longest));
        let timeout = Timespec { tv_sec: 0, tv_nsec: wait.subsec_nanos().into() };
        let mut fds = [0, 1].map(|i| PollFd::from_borrowed_fd(ends[i].as_fd(), PollFlags::IN));
        let _ = poll(&mut fds, Some(&timeout));
        let now = *impairment.lock().unwrap_or_else(PoisonError::into_inner);
        for (i, end) in ends.iter().enumerate() {
            // Bounded, so that a flood from one end does not hold the other one up.
            for _ in 0..64 {
                let Ok(length) = end.recv(&mut buffer) else { break };
                traffic.frames.fetch_add(1, Ordering::Relaxed);
                traffic.bytes.fetch_add(length as u64, Ordering::Relaxed);
                let put = now.fate(&mut random).is_some_and(|delay| {
                    let bytes = buffer.get(..length).unwrap_or_default().to_vec();
                    queue.put(began.elapsed() + delay, 1 - i, bytes)
                });
                if !put {
                    traffic.lost.fetch_add(1, Ordering::Relaxed);
                }
            }
        }
        while let Some((to, bytes)) = queue.take(began.elapsed()) {
            if ends.get(to).is_none_or(|end| end.send(&bytes).is_err()) {
                traffic.lost.fetch_add(1, Ordering::Relaxed);
            }
        }
    }
}
