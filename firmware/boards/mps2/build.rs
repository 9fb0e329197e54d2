//! Where the linker finds this board's memory map.

use std::path::PathBuf;
use std::{env, fs};

fn main() {
    let here = PathBuf::from(env::var_os("CARGO_MANIFEST_DIR").unwrap_or_default());
    let out = PathBuf::from(env::var_os("OUT_DIR").unwrap_or_default());
    // The checks are larger than the product, and keep whole machines on their stack.
    let checks = env::var_os("CARGO_FEATURE_CHECKS").is_some();
    let map = if checks { "checks.x" } else { "product.x" };
    let copied = fs::copy(here.join("memory").join(map), out.join("memory.x"));
    copied.expect("the memory map can be copied");
    println!("cargo:rustc-link-search={}", out.display());
    println!("cargo:rustc-link-search={}", here.display());
    println!("cargo:rustc-link-arg-bins=-Tlink.x");
    if env::var_os("CARGO_FEATURE_DEFMT").is_some() {
        // The texts of the log have a section of their own, which is in the image's file and not in
        // the flash.
        println!("cargo:rustc-link-arg-bins=-Tdefmt.x");
    }
    println!("cargo:rerun-if-changed=memory");
    println!("cargo:rerun-if-changed=device.x");
}
