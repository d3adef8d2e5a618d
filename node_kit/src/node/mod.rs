//! Nodes on DDS: a node implements [`NodeShell`] and works with its [`NodeContext`]; [`run_node`]
//! is a binary's whole `main`, and a [`Process`] holds several nodes.

mod clock;
mod context;
mod control_services;
mod devices;
mod diagnostics;
mod domain;
mod endpoints;
mod error;
mod event;
mod graph;
mod handle;
mod intra_process;
mod large_reply;
mod log_file;
mod logger;
mod middleware;
mod participant;
mod process;
mod publisher;
mod reactor;
mod reply_budget;
mod run;
mod runner;
mod service;
mod shell;
mod subscription;
mod supervisor;
mod tf;
mod timers;
mod wire;

pub use clock::{Clock, ClockWatch};
pub use context::{IntoInput, NodeContext};
pub use devices::DeviceSender;
pub use diagnostics::Health;
pub use endpoints::with_type_hash;
pub use error::NodeError;
pub use handle::NodeHandle;
pub use logger::Logger;
pub use middleware::{Loss, MiddlewareWatch};
pub use participant::join;
pub use process::{Process, Stopper};
pub use publisher::Publisher;
pub use run::{run_node, run_node_with};
pub use service::Responder;
pub use shell::NodeShell;
