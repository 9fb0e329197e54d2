//! Block by which the boot ROM recognises the image (RP2350 datasheet, 5.9).

/// An image for the Arm cores in secure state, with its vector table at the start of the flash.
#[unsafe(link_section = ".boot_block")]
#[unsafe(no_mangle)]
#[used]
static BOOT_BLOCK: [u32; 5] = [
    0xFFFF_DED3, // start of a block
    0x1021_0142, // image type: executable, secure, Arm, RP2350
    0x0000_01FF, // end of the items, of which there is one word
    0,           // the only block of its loop
    0xAB12_3579, // end of the block
];
