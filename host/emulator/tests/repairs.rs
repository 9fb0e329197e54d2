//! Repairs of the emulator, with a few instructions or registers of the chip.

use haptimill_emulator::chip::Chip;
use rp2350_emu::peripherals::usb::UsbAnswer;

const RAM: u32 = 0x2000_0000;
const CODE: u32 = 0x1000_0100;

/// A chip that runs these half words, with the address of the RAM in r0.
fn chip(code: &[u16]) -> Chip {
    let mut flash = vec![0xFF; 0x100];
    flash[..4].copy_from_slice(&(RAM + 0x8000).to_le_bytes());
    flash[4..8].copy_from_slice(&(CODE | 1).to_le_bytes());
    // r0 = RAM, then the code, then an endless loop.
    let all = [0x2001_u16, 0x0740].iter().chain(code).chain(&[0xE7FE]);
    flash.extend(all.flat_map(|half| half.to_le_bytes()));
    flash.resize(0x1000, 0xFF);
    Chip::new(&flash).unwrap()
}

fn run(code: &[u16], cycles: u32) -> Chip {
    let mut chip = chip(code);
    for _ in 0..cycles {
        chip.cycle().unwrap();
    }
    chip
}

#[test]
fn interrupts_are_masked_and_unmasked() {
    // cpsid i; mrs r1, primask; mrs r2, faultmask; cpsie i; mrs r3, primask
    let code = [
        0xB672, 0xF3EF, 0x8110, 0xF3EF, 0x8213, 0xB662, 0xF3EF, 0x8310,
    ];
    let chip = run(&code, 200);
    assert_eq!(chip.core_register(1), 1, "primask is set");
    assert_eq!(chip.core_register(2), 0, "faultmask is not");
    assert_eq!(chip.core_register(3), 0, "primask is cleared");
}

#[test]
fn load_acquire_and_store_release_are_executed() {
    // movs r1, #7; stl r1, [r0]; lda r2, [r0]; ldab r3, [r0]
    let chip = run(
        &[0x2107, 0xE8C0, 0x1FAF, 0xE8D0, 0x2FAF, 0xE8D0, 0x3F8F],
        200,
    );
    assert_eq!((chip.core_register(2), chip.core_register(3)), (7, 7));
}

/// A return from a handler by a conditional instruction kept the flags of the handler, and advanced
/// the IT block that the interrupt had left.
#[test]
fn a_conditional_return_from_a_handler_restores_flags_and_it_block() {
    const HANDLER: u32 = 0x1000_0200;
    // r1 = ICSR; r2 = PENDSVSET; r4 = r6 = 0; cmp r4, #0; ite eq; streq r2, [r1]; movne r6, #5;
    // mrs r3, apsr
    let code: [u16; 14] = [
        0xF64E, 0x5104, 0xF2CE, 0x0100, 0x2201, 0x0712, 0x2400, 0x2600, 0x2C00, 0xBF0C, 0x600A,
        0x2605, 0xF3EF, 0x8300,
    ];
    // movs r5, #1; cmp r5, #0; it ne; bxne lr
    let handler: [u16; 4] = [0x2501, 0x2D00, 0xBF18, 0x4770];
    let mut flash = vec![0xFF; 0x1000];
    let mut put = |at: u32, bytes: &[u8]| {
        let at = (at - 0x1000_0000) as usize;
        flash[at..at + bytes.len()].copy_from_slice(bytes);
    };
    put(0x1000_0000, &(RAM + 0x8000).to_le_bytes());
    put(0x1000_0004, &(CODE | 1).to_le_bytes());
    put(0x1000_0038, &(HANDLER | 1).to_le_bytes());
    let bytes = |code: &[u16]| -> Vec<u8> { code.iter().flat_map(|it| it.to_le_bytes()).collect() };
    put(CODE, &bytes(&code));
    put(CODE + 28, &bytes(&[0xE7FE]));
    put(HANDLER, &bytes(&handler));
    let mut chip = Chip::new(&flash).unwrap();
    for _ in 0..400 {
        chip.cycle().unwrap();
    }
    assert_eq!(chip.core_register(5), 0x1, "the handler ran");
    assert_eq!(chip.core_register(3) >> 28, 0b0110, "zero and carry");
    assert_eq!(chip.core_register(6), 0, "movne is not executed");
}

/// Without it all handlers have one priority, and SysTick waits for PendSV.
#[test]
fn priorities_of_handlers_have_byte_access() {
    // r1 = SHPR3; bytes of SysTick 0x20 and of PendSV 0xE0; ldr r3, [r1]; ldrb r4, [r1, #3]
    let code = [
        0xF64E, 0x5120, 0xF2CE, 0x0100, 0x2220, 0x70CA, 0x22E0, 0x708A, 0x680B, 0x78CC,
    ];
    let chip = run(&code, 200);
    assert_eq!(chip.core_register(3), 0x20E0_0000);
    assert_eq!(chip.core_register(4), 0x20);
}

#[test]
fn systick_fires_when_it_reaches_zero_in_steps_of_one_cycle() {
    // r1 = SysTick; reload 9, value 0, enabled; 40 times nop; ldr r3, [r1]
    let mut code = vec![0xF24E, 0x0110, 0xF2CE, 0x0100];
    code.extend([0x2209, 0x604A, 0x2200, 0x608A, 0x2205, 0x600A]);
    code.extend([0xBF00; 40]);
    code.push(0x680B);
    let chip = run(&code, 300);
    assert_eq!(chip.core_register(3) >> 16, 1, "COUNTFLAG");
}

#[test]
fn the_watchdog_counts_ticks_and_not_cycles() {
    let mut chip = chip(&[]);
    // 12 cycles of the reference a tick, load 100, enabled.
    chip.set_register(0x4010_8034, 12);
    chip.set_register(0x4010_8030, 1);
    chip.set_register(0x400D_8004, 100);
    chip.set_register(0x400D_8000, 1 << 30);
    for _ in 0..600 {
        chip.cycle().unwrap();
    }
    let left = chip.register(0x400D_8000) & 0xFF_FFFF;
    assert!((1..100).contains(&left), "{left}");
}

#[test]
fn state_machines_of_two_blocks_start_in_the_same_cycle() {
    let mut chip = chip(&[]);
    // Nothing is in reset.
    chip.set_register(0x4002_0000, 0);
    // A program of jumps to the next instruction in both blocks.
    // After one write their addresses are equal.
    for block in [0x5020_0000, 0x5030_0000] {
        for at in 0..31 {
            chip.set_register(block + 0x48 + 4 * at, at + 1);
        }
        chip.set_register(block + 0xC8, 1 << 16);
    }
    chip.set_register(0x5020_0000, 1 | 1 << 24 | 1 << 20);
    for _ in 0..17 {
        chip.cycle().unwrap();
    }
    let first = chip.register(0x5020_00D4);
    assert_ne!(first, 0);
    assert_eq!(chip.register(0x5030_00D4), first);
}

#[test]
fn a_decrement_of_zero_wraps() {
    let mut chip = chip(&[]);
    // Nothing is in reset.
    chip.set_register(0x4002_0000, 0);
    // jmp x--, 1; mov isr, x; push; jmp 3
    for (at, word) in [0x0041, 0xA0C1, 0x8020, 0x0003].into_iter().enumerate() {
        chip.set_register(0x5020_0048 + 4 * at as u32, word);
    }
    chip.set_register(0x5020_00C8, 1 << 16);
    chip.set_register(0x5020_00CC, 31 << 12);
    chip.set_register(0x5020_0000, 1);
    for _ in 0..20 {
        chip.cycle().unwrap();
    }
    assert_eq!(chip.register(0x5020_0020), u32::MAX);
}

#[test]
fn the_uart_receives_and_sends() {
    let mut chip = chip(&[]);
    // Divider 1, FIFOs, enabled.
    chip.set_register(0x4007_0024, 1);
    chip.set_register(0x4007_002C, 0x70);
    chip.set_register(0x4007_0030, 0x301);
    chip.receive(&[0x5A]);
    chip.set_register(0x4007_0000, 0xA5);
    for _ in 0..20_000 {
        chip.cycle().unwrap();
    }
    assert_eq!(chip.register(0x4007_0000) & 0xFF, 0x5A);
    assert_eq!(chip.take_sent(), [0xA5]);
    // The FIFO keeps 32 bytes that nobody takes.
    chip.receive(&[7; 40]);
    for _ in 0..20_000 {
        chip.cycle().unwrap();
    }
    let taken = (0..40).filter(|_| chip.register(0x4007_0000) & 0xFF == 7);
    assert_eq!(taken.count(), 32);
}

/// The device controller of the USB, driven by its registers and a host.
#[test]
fn the_usb_controller_has_transactions() {
    const USB: u32 = 0x5011_0000;
    const MEMORY: u32 = 0x5010_0000;
    let mut chip = chip(&[]);
    chip.set_register(0x4002_0000, 0);
    assert_eq!(chip.usb(|it| it.setup(0, [0; 8])), UsbAnswer::Silence);
    // To the pads, supply there, device enabled, events of endpoint 0, pull-up.
    for (at, word) in [
        (0x74, 9),
        (0x78, 0xC),
        (0x40, 1),
        (0x4C, 1 << 29 | 1 << 16),
        (0x00, 7),
    ] {
        chip.set_register(USB + at, word);
    }
    // Endpoint 1 of both directions, enabled, each with a buffer of its own, reported.
    chip.set_register(MEMORY + 0x8, 0xA800_0180);
    chip.set_register(MEMORY + 0xC, 0xA800_01C0);
    assert_eq!(chip.usb(|it| it.setup(6, [0; 8])), UsbAnswer::Silence);
    let packet = [1, 2, 3, 4, 5, 6, 7, 8];
    assert_eq!(chip.usb(|it| it.setup(7, packet)), UsbAnswer::Ack);
    assert_eq!(chip.register(MEMORY), 0x0403_0201);
    assert_eq!(chip.register(USB + 0x50), 1 << 17 | 1);
    chip.set_register(USB + 0x50, 1 << 17);
    assert_eq!(chip.register(USB + 0x50), 1);
    // Not given, given for another toggle, given.
    let send = |chip: &mut Chip| chip.usb(|it| it.receive(7, 1, true, b"abcd"));
    assert_eq!(send(&mut chip), UsbAnswer::Nak);
    chip.set_register(MEMORY + 0x8C, 64);
    chip.set_register(MEMORY + 0x8C, 64 | 1 << 10);
    assert_eq!(send(&mut chip), UsbAnswer::Ack);
    assert_eq!(chip.register(USB + 0x58), 0, "a packet that came twice");
    chip.set_register(MEMORY + 0x8C, 64 | 1 << 13);
    chip.set_register(MEMORY + 0x8C, 64 | 1 << 13 | 1 << 10);
    assert_eq!(send(&mut chip), UsbAnswer::Ack);
    assert_eq!(chip.register(USB + 0x58), 1 << 3);
    assert_eq!(chip.register(MEMORY + 0x8C), 4 | 1 << 13 | 1 << 15);
    assert_eq!(chip.register(MEMORY + 0x1C0), u32::from_le_bytes(*b"abcd"));
    chip.set_register(USB + 0x58, 1 << 3);
    assert_eq!(chip.register(USB + 0x58), 0);
    assert_eq!(send(&mut chip), UsbAnswer::Nak);
    // Two bytes to the host.
    assert_eq!(chip.usb(|it| it.transmit(7, 1)), UsbAnswer::Nak);
    chip.set_register(MEMORY + 0x180, 0x6261);
    chip.set_register(MEMORY + 0x88, 2 | 1 << 15);
    assert_eq!(chip.wrong_usb_writes(), 0);
    chip.set_register(MEMORY + 0x88, 2 | 1 << 15 | 1 << 10 | 1 << 13);
    assert_eq!(chip.wrong_usb_writes(), 1, "the toggle came with AVAILABLE");
    let bytes = b"ab".to_vec();
    let sent = UsbAnswer::Data {
        toggle: true,
        bytes,
    };
    assert_eq!(chip.usb(|it| it.transmit(7, 1)), sent);
    assert_eq!(chip.usb(|it| it.transmit(7, 1)), UsbAnswer::Nak);
    assert_eq!(chip.register(USB + 0x58), 1 << 2);
    // Endpoint 1 stalls; endpoint 0 only while it is armed.
    chip.set_register(MEMORY + 0x88, 1 << 11);
    assert_eq!(chip.usb(|it| it.transmit(7, 1)), UsbAnswer::Stall);
    chip.set_register(MEMORY + 0x80, 1 << 11);
    assert_eq!(chip.usb(|it| it.transmit(7, 0)), UsbAnswer::Nak);
    chip.set_register(USB + 0x68, 1);
    assert_eq!(chip.usb(|it| it.transmit(7, 0)), UsbAnswer::Stall);
    assert_eq!(chip.usb(|it| it.setup(7, packet)), UsbAnswer::Ack);
    assert_eq!(chip.usb(|it| it.transmit(7, 0)), UsbAnswer::Nak);
}

/// The watchdog resets the chip, which starts again, and reports the cause.
#[test]
fn the_watchdog_resets_the_chip() {
    // r1 = WATCHDOG; ldr r2, [r1, #8]
    let mut chip = run(&[0xF248, 0x0100, 0xF2C4, 0x010D, 0x688A], 200);
    assert_eq!(chip.core_register(2), 0);
    chip.set_register(0x4010_8034, 12);
    chip.set_register(0x4010_8030, 1);
    chip.set_register(0x400D_8010, 77);
    chip.set_register(0x400D_8004, 2);
    chip.set_register(0x400D_8000, 1 << 30);
    let before = chip.cycles();
    for _ in 0..2000 {
        chip.cycle().unwrap();
    }
    assert_eq!(chip.resets(), 1);
    assert!(chip.cycles() >= before + 2000, "the time goes on");
    assert_eq!(chip.core_register(2), 1, "the timer of the watchdog");
    assert_eq!(chip.register(0x400D_8010), 77, "its scratch registers stay");
}

/// SPI1 at its pins: a word leaves and another one arrives, in mode 3 and in mode 0.
#[test]
fn the_spi_moves_its_pins_and_samples_the_data() {
    const SPI1: u32 = 0x4008_8000;
    const IO_BANK0: u32 = 0x4002_8000;
    for (mode, idle) in [(0b11 << 6, true), (0, false)] {
        let mut chip = chip(&[]);
        chip.set_register(0x4002_0000, 0);
        // 20 cycles of the clock of the devices a bit; words of 8 bits; enabled.
        chip.set_register(SPI1 + 0x10, 20);
        chip.set_register(SPI1, mode | 7);
        chip.set_register(SPI1 + 0x4, 2);
        // Without their function the pins stay low.
        chip.set_register(SPI1 + 0x8, 0xFF);
        let mut seen = 0;
        for _ in 0..2000 {
            seen |= chip.cycle().unwrap();
        }
        assert_eq!(seen & 7 << 26, 0);
        assert_eq!(chip.register(SPI1 + 0x8), 0, "the data were low");
        for pin in 26..29 {
            chip.set_register(IO_BANK0 + 4 + 8 * pin, 1);
        }
        let level = |pins: u32, pin: u32| pins >> pin & 1 != 0;
        let mut before = chip.cycle().unwrap();
        assert_eq!(level(before, 26), idle);
        chip.set_register(SPI1 + 0x8, 0x96);
        let (mut sent, mut rises, mut next) = (0, 0, 0x3A_u32);
        // A chip in this mode: its data change at the falling clock, or are there before.
        chip.drive(1 << 28, if idle { 0 } else { (next >> 7 & 1) << 28 });
        next = if idle { next } else { next << 1 };
        for _ in 0..2000 {
            let pins = chip.cycle().unwrap();
            if level(pins, 26) && !level(before, 26) {
                rises += 1;
                sent = sent << 1 | u32::from(level(pins, 27));
            } else if !level(pins, 26) && level(before, 26) {
                chip.drive(1 << 28, (next >> 7 & 1) << 28);
                next <<= 1;
            }
            before = pins;
        }
        assert_eq!((rises, sent), (8, 0x96), "idle {idle}");
        assert_eq!(level(before, 26), idle);
        // Received, not busy.
        assert_eq!(chip.register(SPI1 + 0xC) & 0b10100, 0b100);
        assert_eq!(chip.register(SPI1 + 0x8), 0x3A, "idle {idle}");
    }
}
