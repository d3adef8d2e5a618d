//! `volant-peers`: the project's marker tracker beside its peers, in one run, on scenes made from a
//! seed with truth.
//!
//! `bench` prints the main table (time, accuracy, success) and the targets of the tracker; `sweep`
//! the success over viewing angle and distance; `boards` compares markers with chessboards.

mod bench;
mod boards;
mod clock;
mod measure;
mod methods;
mod progress;
mod report;
mod scene;
mod stage;
mod sweep;
mod trajectory;

use crate::progress::Progress;
use anyhow::{Context, Result};
use clap::{Parser, Subcommand};
use std::{
    alloc::{GlobalAlloc, Layout, System},
    path::PathBuf,
    process::ExitCode,
    sync::atomic::{AtomicU64, Ordering},
};

/// Counts allocations.
struct Counting;

static ALLOCATIONS: AtomicU64 = AtomicU64::new(0);

// SAFETY: every call is handed on to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
        // SAFETY: as for the caller.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as for the caller.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
        // SAFETY: as for the caller.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Allocations of this process so far.
fn allocations() -> u64 {
    ALLOCATIONS.load(Ordering::Relaxed)
}

/// The marker tracker beside its peers.
#[derive(Parser)]
#[command(name = "volant-peers", version)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
    /// Where CSV files go.
    #[arg(long, global = true, default_value = "bench_out")]
    out: PathBuf,
    /// The scenes' seed.
    #[arg(long, global = true, default_value_t = 1)]
    seed: u64,
    /// Lines `progress SHARE` on standard error.
    #[arg(long, global = true)]
    progress: bool,
}

#[derive(Subcommand)]
enum Command {
    /// Time, accuracy and success on one motion; bench.csv, table-1.csv, fig-12.csv.
    Bench {
        /// How many images.
        #[arg(long, default_value_t = 300)]
        images: usize,
    },
    /// Success over viewing angle and distance; fig-11.csv.
    Sweep {
        /// Images per angle and distance.
        #[arg(long, default_value_t = 12)]
        images: usize,
    },
    /// Pose from a chessboard's corners, from four of them and from markers, over the viewing
    /// angle; fig-2.csv, fig-7.csv.
    Boards {
        /// Images per angle.
        #[arg(long, default_value_t = 16)]
        images: usize,
    },
}

fn work(arguments: &Arguments) -> Result<usize> {
    opencv::core::set_num_threads(1)?;
    std::fs::create_dir_all(&arguments.out).with_context(|| {
        format!("creating {}; name a folder with --out", arguments.out.display())
    })?;
    let progress = Progress(arguments.progress);
    match &arguments.command {
        Command::Bench { images } => {
            let outcome = bench::run(*images, arguments.seed, &progress)?;
            outcome.print();
            outcome.write(&arguments.out)?;
            Ok(outcome.targets().print())
        }
        Command::Sweep { images } => {
            Ok(sweep::run(&arguments.out, *images, arguments.seed, &progress)?.print())
        }
        Command::Boards { images } => {
            boards::run(&arguments.out, *images, arguments.seed, &progress)?;
            Ok(0)
        }
    }
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    match work(&arguments) {
        Ok(0) => ExitCode::SUCCESS,
        Ok(failed) => {
            eprintln!("volant-peers: {failed} figures are short of their target");
            ExitCode::FAILURE
        }
        Err(error) => {
            eprintln!("volant-peers: {error:#}");
            ExitCode::FAILURE
        }
    }
}
