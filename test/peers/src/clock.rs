//! Time that this thread had the core: other processes on the machine do not count against a
//! method.

use std::time::Duration;

#[derive(Clone, Copy, Debug)]
pub struct Clock(Duration);

impl Clock {
    pub fn start() -> Self {
        Self(thread_time())
    }

    pub fn elapsed(&self) -> Duration {
        thread_time().saturating_sub(self.0)
    }
}

fn thread_time() -> Duration {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: the pointer is to a timespec that lives through the call.
    unsafe { libc::clock_gettime(libc::CLOCK_THREAD_CPUTIME_ID, &mut time) };
    Duration::new(time.tv_sec.unsigned_abs(), time.tv_nsec.unsigned_abs() as u32)
}
