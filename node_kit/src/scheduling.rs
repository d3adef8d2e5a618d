//! Scheduling of a node's process: real-time priority, processor affinity, memory lock.
//!
//! Threads inherit both from the thread that starts them, so that one call before the DDS domain is
//! joined covers the nodes, their devices and the middleware. The allocator's own threads, which
//! return memory to the system, start before `main` and keep the usual priority.

use crate::{args::ArgumentError, node::NodeError};
use rustix::{
    io::Errno,
    mm::{MlockAllFlags, mlockall},
    process::{Resource, getrlimit},
    thread::{CapabilitySet, CpuSet, capabilities, sched_setaffinity},
};
use std::io;

/// Options of [`Scheduling`] on a command line.
pub const OPTIONS: [&str; 3] = ["realtime-priority", "cpus", "lock-memory"];

/// Lines about [`OPTIONS`] for `--help`.
pub const HELP: &str =
    "  --realtime-priority N   run with SCHED_FIFO and this priority, 1 to 99 (default: off)
  --cpus 2,3              run on these processors only (default: all)
  --lock-memory           keep all memory resident (default: off)
";

/// Scheduling of a process; the default changes nothing.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Scheduling {
    /// Priority of `SCHED_FIFO`, 1 to 99.
    pub priority: Option<u8>,
    /// Numbers of the processors that the process may use; empty: all.
    pub cpus: Vec<usize>,
    /// Whether all memory stays resident.
    pub lock_memory: bool,
}

impl Scheduling {
    /// Takes the options out of a command line and returns the rest.
    ///
    /// # Errors
    /// An option without a value, or with an invalid one.
    pub fn take(words: Vec<String>) -> Result<(Self, Vec<String>), ArgumentError> {
        let (mut scheduling, mut rest) = (Self::default(), Vec::new());
        let mut words = words.into_iter();
        while let Some(word) = words.next() {
            let (name, inline) = match word.split_once('=') {
                Some((name, value)) => (name, Some(value.to_owned())),
                None => (word.as_str(), None),
            };
            let expected = match name {
                "--lock-memory" if inline.is_none() => {
                    scheduling.lock_memory = true;
                    continue;
                }
                "--realtime-priority" => "a number from 1 to 99",
                "--cpus" => "numbers of processors such as 2,3",
                _ => {
                    rest.push(word);
                    continue;
                }
            };
            let value = inline
                .or_else(|| words.next())
                .ok_or_else(|| ArgumentError::no_value(name, expected))?;
            let understood = if name == "--cpus" {
                let cpus: Option<Vec<usize>> =
                    value.split(',').map(|n| n.trim().parse().ok()).collect();
                let limited = cpus.filter(|all| all.iter().all(|n| *n < CpuSet::MAX_CPU));
                limited.map(|cpus| scheduling.cpus = cpus)
            } else {
                let priority = value.parse().ok().filter(|n| (1..=99).contains(n));
                priority.map(|n| scheduling.priority = Some(n))
            };
            if understood.is_none() {
                return Err(ArgumentError::malformed(name, &value, expected));
            }
        }
        Ok((scheduling, rest))
    }

    /// Applies it to the calling thread and to every thread that it starts later.
    ///
    /// # Errors
    /// What the system does not permit, with the remedy.
    pub fn apply(&self) -> Result<(), NodeError> {
        if !self.cpus.is_empty() {
            let mut set = CpuSet::new();
            self.cpus.iter().for_each(|n| set.set(*n));
            sched_setaffinity(None, &set).map_err(|e| {
                let cpus = self.cpus.iter().map(usize::to_string).collect::<Vec<_>>().join(",");
                NodeError::shell(format!(
                    "--cpus {cpus}: {}; `cat /sys/fs/cgroup/cpuset.cpus.effective` and `nproc \
                     --all` show which processors there are",
                    io::Error::from(e)
                ))
            })?;
        }
        if self.lock_memory {
            // Below a finite limit the call succeeds and a later allocation fails. CAP_IPC_LOCK
            // lifts the limit; root in a container may lack it.
            let unlimited = getrlimit(Resource::Memlock).current.is_none()
                || capabilities(None)
                    .is_ok_and(|own| own.effective.contains(CapabilitySet::IPC_LOCK));
            let locked = if unlimited {
                mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE)
            } else {
                Err(Errno::PERM)
            };
            locked.map_err(|e| {
                NodeError::shell(format!(
                    "--lock-memory: {}; permit it with LimitMEMLOCK=infinity in the systemd unit, \
                     or with `USER - memlock unlimited` in /etc/security/limits.conf",
                    io::Error::from(e)
                ))
            })?;
        }
        if let Some(priority) = self.priority {
            set_fifo(priority).map_err(|error| {
                NodeError::shell(format!(
                    "--realtime-priority {priority}: {error}; permit it with \
                     LimitRTPRIO={priority} in the systemd unit, or with `USER - rtprio \
                     {priority}` in /etc/security/limits.conf"
                ))
            })?;
        }
        Ok(())
    }
}

/// Sets the calling thread to `SCHED_FIFO`.
#[allow(unsafe_code, reason = "rustix has no sched_setscheduler, and musl's returns ENOSYS")]
fn set_fifo(priority: u8) -> io::Result<()> {
    // The only field of the kernel's `sched_param`.
    let parameter = libc::c_int::from(priority);
    let (call, policy) = (libc::SYS_sched_setscheduler, libc::SCHED_FIFO);
    // SAFETY: the parameter is initialized and outlives the call, which only reads it.
    match unsafe { libc::syscall(call, 0, policy, &raw const parameter) } {
        0 => Ok(()),
        _ => Err(io::Error::last_os_error()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn take(line: &str) -> Result<(Scheduling, Vec<String>), ArgumentError> {
        Scheduling::take(line.split_whitespace().map(str::to_owned).collect())
    }

    #[test]
    fn the_options_are_taken_and_the_rest_stays() {
        let (scheduling, rest) =
            take("--rig r.yaml --realtime-priority 20 --cpus=0,1 --lock-memory --port p").unwrap();
        let expected = Scheduling { priority: Some(20), cpus: vec![0, 1], lock_memory: true };
        assert_eq!(scheduling, expected);
        assert_eq!(rest, ["--rig", "r.yaml", "--port", "p"]);
        assert_eq!(take("--rig r.yaml").unwrap().0, Scheduling::default());
    }

    #[test]
    fn invalid_values_are_named() {
        for line in [
            "--realtime-priority 0",
            "--realtime-priority 100",
            "--realtime-priority high",
            "--realtime-priority",
            "--cpus 1,x",
            "--cpus 5000",
        ] {
            let error = take(line).unwrap_err();
            assert!(error.is_usage(), "{line}");
            assert!(error.to_string().contains(line.split(' ').next().unwrap()), "{error}");
        }
    }

    #[test]
    fn affinity_is_applied_to_new_threads_and_a_missing_processor_is_named() {
        std::thread::spawn(|| {
            Scheduling { cpus: vec![0], ..Scheduling::default() }.apply().unwrap();
            let status = std::thread::spawn(|| std::fs::read_to_string("/proc/thread-self/status"));
            let status = status.join().unwrap().unwrap();
            let line = status.lines().find(|l| l.starts_with("Cpus_allowed_list:")).unwrap();
            assert_eq!(line.split_whitespace().nth(1), Some("0"));
            let missing = Scheduling { cpus: vec![1023], ..Scheduling::default() };
            let error = missing.apply().unwrap_err().to_string();
            assert!(error.contains("--cpus 1023"), "{error}");
        })
        .join()
        .unwrap();
    }
}
