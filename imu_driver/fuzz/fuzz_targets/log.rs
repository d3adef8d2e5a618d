#![no_main]

#[path = "../exercise.rs"]
#[allow(dead_code)]
mod exercise;
#[path = "../seeds.rs"]
mod seeds;

libfuzzer_sys::fuzz_target!(init: seeds::write("log"), |data: &[u8]| exercise::log(data));
