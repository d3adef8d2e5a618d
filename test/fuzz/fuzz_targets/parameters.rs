#![no_main]

libfuzzer_sys::fuzz_target!(init: volant_fuzz::write_seeds("parameters"), |data: &[u8]| volant_fuzz::run("parameters", data));
