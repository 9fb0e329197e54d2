//! Where the linker finds the script of this image.

use std::env;

fn main() {
    let here = env::var("CARGO_MANIFEST_DIR").unwrap_or_default();
    println!("cargo:rustc-link-arg-bins=-T{here}/image.x");
    println!("cargo:rerun-if-changed=image.x");
}
