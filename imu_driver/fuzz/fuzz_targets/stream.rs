#![no_main]

#[path = "../exercise.rs"]
#[allow(dead_code)]
mod exercise;
#[path = "../seeds.rs"]
mod seeds;

libfuzzer_sys::fuzz_target!(init: seeds::write("stream"), |data: &[u8]| exercise::stream(data));
