#![no_main]

volant_fuzz::target!("driver");
