//! Tables of pins in the pages of the boards, and what the image sets at a pin.

use haptimill_emulator::chip::Chip;

/// Registers of the chip (RP2350 datasheet, 9.11 and 12.5).
const IO_BANK0: u32 = 0x4002_8000;
const PADS_BANK0: u32 = 0x4003_8000;
const SIO_OUTPUT_ENABLE: u32 = 0xD000_0030;

/// Functions of a pin.
const UART: u32 = 2;
const PWM: u32 = 4;
const SOFTWARE: u32 = 5;
const PIO: [u32; 2] = [6, 7];

/// A row of the table: its pins, and whether they are outputs.
pub struct Row {
    pub pins: Vec<u32>,
    pub directions: Vec<bool>,
    pub signal: String,
}

/// The rows of the table of a page with pins of the chip.
pub fn table(page: &str) -> Vec<Row> {
    let number = |word: &str| word.trim_matches(',').strip_prefix("GP")?.parse().ok();
    let (_, table) = page
        .split_once("| pin | direction | signal |\n")
        .expect("the page has the table");
    let rows = table.lines().take_while(|line| line.starts_with('|'));
    let rows = rows.filter(|line| line.starts_with("| GP"));
    rows.map(|line| {
        let cells: Vec<&str> = line.split('|').map(str::trim).collect();
        let [_, pins, directions, signal, _] = cells[..] else {
            panic!("{line}")
        };
        let mut numbers: Vec<u32> = pins.split(' ').filter_map(number).collect();
        if pins.contains(" to ") {
            numbers = (numbers[0]..=numbers[1]).collect();
        }
        Row {
            pins: numbers,
            directions: directions.split(", ").map(|it| it == "out").collect(),
            signal: signal.to_string(),
        }
    })
    .collect()
}

/// Asserts that a pin has the function and the pulls of its direction.
pub fn assert_is_set(chip: &mut Chip, pin: u32, is_output: bool, has_uart: bool) {
    let function = chip.register(IO_BANK0 + 4 + 8 * pin) & 0x1F;
    let pad = chip.register(PADS_BANK0 + 4 + 4 * pin);
    let by_software = chip.register(SIO_OUTPUT_ENABLE) >> pin & 1 != 0;
    let (pulls_down, pulls_up) = (pad >> 2 & 1 != 0, pad >> 3 & 1 != 0);
    let text = format!("GP{pin}: function {function}, pad {pad:#x}, software {by_software}");
    assert_eq!(pad >> 7 & 0b11, 0, "disabled or isolated, {text}");
    assert_ne!(pad >> 6 & 1, 0, "the input buffer is off, {text}");
    if function == UART {
        assert!(has_uart && pin < 2 && pulls_up, "{text}");
    } else if is_output {
        let drives = match function {
            SOFTWARE => by_software,
            function => function == PWM || PIO.contains(&function),
        };
        // Without a program the line falls.
        assert!(drives && pulls_down && !pulls_up, "{text}");
    } else {
        // A broken wire is high.
        assert!(function == SOFTWARE && !by_software, "{text}");
        assert!(pulls_up && !pulls_down, "{text}");
    }
}
