//! Parsing and decoding allocate nothing per frame: counted by the allocator itself.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)]
#![allow(unsafe_code, reason = "an allocator cannot be written without; it only counts and passes on")]

use imu_driver::protocol::{
    Decoder, FrameParser, LegacyFormat, Measurement, MessageId, NumberFormat, frame, mtdata2,
};
use std::{
    alloc::{GlobalAlloc, Layout, System},
    cell::Cell,
};

thread_local! {
    static COUNT: Cell<usize> = const { Cell::new(0) };
}

struct Counting;

// SAFETY: every call is passed on to the system's allocator as it is.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let _ = COUNT.try_with(|c| c.set(c.get() + 1));
        // SAFETY: the caller's promises are the system allocator's.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the pointer came from `alloc` above.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn ten_thousand_frames_cost_no_allocation() {
    let m = Measurement {
        acceleration: Some([0.1, 0.2, 9.8]),
        angular_velocity: Some([0.0; 3]),
        counter: Some(1),
        ..Measurement::default()
    };
    let mut stream = Vec::new();
    for number in NumberFormat::ALL {
        let mut data = Vec::new();
        mtdata2::encode(&m, number, &mut data);
        stream.extend(frame(MessageId::MT_DATA2, &data));
    }
    let mut data = Vec::new();
    LegacyFormat::STANDARD.encode(&m, &mut data);
    stream.extend(frame(MessageId::MT_DATA, &data));
    // Damage, too: garbage and a frame with a wrong checksum.
    stream.extend([0xFA, 0xFF, 0x32, 0x02, 1, 2, 3, 4]);
    let mut parser = FrameParser::new();
    let mut decoder = Decoder { format: Some(LegacyFormat::STANDARD) };
    let mut measurement = Measurement::default();
    let before = COUNT.with(Cell::get);
    let mut decoded = 0;
    for _ in 0..2_000 {
        for portion in stream.chunks(37) {
            parser.parse(portion, |f| {
                decoded += usize::from(decoder.decode_into(&f, &mut measurement) == Ok(true))
            });
        }
    }
    let allocations = COUNT.with(Cell::get) - before;
    println!("{decoded} frames decoded, {allocations} allocations");
    assert_eq!((decoded, allocations), (10_000, 0));
    // The counter counts.
    let probe = Box::new(1_u8);
    assert!(COUNT.with(Cell::get) > before, "{probe}");
}
