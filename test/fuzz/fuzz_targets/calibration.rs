#![no_main]

libfuzzer_sys::fuzz_target!(init: volant_fuzz::write_seeds("calibration"), |data: &[u8]| volant_fuzz::run("calibration", data));
