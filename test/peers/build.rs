//! Compiles the few lines of C through which AprilTag 3 is called.

fn main() {
    println!("cargo:rerun-if-changed=src/apriltag_shim.c");
    cc::Build::new().file("src/apriltag_shim.c").warnings(true).compile("apriltag_shim");
    println!("cargo:rustc-link-lib=apriltag");
    println!("cargo:rustc-link-lib=apriltag-utils");
}
