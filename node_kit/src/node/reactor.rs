//! The thread that reads a node's subscriptions and services, so that a busy node never holds up
//! the middleware.

use super::error::NodeError;
use async_executor::Executor;
pub use async_executor::Task;
use std::{future::Future, sync::Arc, thread::JoinHandle};

/// A thread that runs the tasks which read subscriptions and services; dropping it ends them.
pub struct Reactor {
    executor: Arc<Executor<'static>>,
    stop: async_channel::Sender<()>,
    thread: Option<JoinHandle<()>>,
}

impl Reactor {
    /// Starts the thread, with the name of its node.
    ///
    /// # Errors
    /// The system starts no thread.
    pub fn start(node: &str) -> Result<Self, NodeError> {
        let executor = Arc::new(Executor::new());
        let (stop, stopped) = async_channel::bounded::<()>(1);
        // The kernel truncates names to 15 bytes.
        let thread = std::thread::Builder::new()
            .name(format!("dds_{node}").chars().take(15).collect())
            .spawn({
                let executor = Arc::clone(&executor);
                move || {
                    // Ends when the sender is dropped.
                    let _ = futures_lite::future::block_on(executor.run(stopped.recv()));
                }
            })
            .map_err(|error| NodeError::System { what: "a thread".into(), error })?;
        Ok(Self { executor, stop, thread: Some(thread) })
    }

    /// Runs a future on the thread until its task drops.
    pub fn spawn(&self, future: impl Future<Output = ()> + Send + 'static) -> Task<()> {
        self.executor.spawn(future)
    }
}

impl Drop for Reactor {
    fn drop(&mut self) {
        self.stop.close();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
        // Remaining tasks, and with them every subscription and service, drop with the executor.
    }
}
