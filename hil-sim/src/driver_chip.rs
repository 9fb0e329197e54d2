//! What the models of driver chips of step motors share: registers, temperature and shorts.

/// A register by its data sheet: address, readable, writable, value after a reset.
pub type Register = (u8, bool, bool, u32);

/// Flags of GSTAT, which both chips have: it was reset; it switched its motor off.
pub const RESET: u32 = 1;
pub const DRIVE_ERROR: u32 = 2;

/// Temperature at which a chip warns, C.
pub const WARNING_C: f64 = 120.0;

/// The registers of a chip.
#[derive(Debug, Clone)]
pub struct Registers<const N: usize> {
    table: &'static [Register; N],
    values: [u32; N],
    /// A register that keeps its value whatever is written.
    stuck: Option<u8>,
}

impl<const N: usize> Registers<N> {
    /// The registers of a table, after a reset.
    pub fn new(table: &'static [Register; N]) -> Self {
        Self {
            table,
            values: table.map(|(_, _, _, value)| value),
            stuck: None,
        }
    }

    /// A reset: the registers have the values of the table, and the latched flags that of a reset.
    pub fn reset(&mut self, flags: u8) {
        self.values = self.table.map(|(_, _, _, value)| value);
        *self.value(flags) = RESET;
    }

    /// Makes a register keep its value whatever is written.
    pub const fn set_stuck(&mut self, register: Option<u8>) {
        self.stuck = register;
    }

    fn index(&self, register: u8) -> Option<usize> {
        self.table.iter().position(|(it, ..)| *it == register)
    }

    /// Value of a register; 0 of one that is not in the table.
    pub fn get(&self, register: u8) -> u32 {
        self.index(register).map_or(0, |at| self.values[at])
    }

    /// Value of a register of the table.
    pub fn value(&mut self, register: u8) -> &mut u32 {
        let at = self.index(register).expect("a register of the table");
        &mut self.values[at]
    }

    /// A datagram can read the register.
    pub fn is_readable(&self, register: u8) -> bool {
        self.index(register).is_some_and(|at| self.table[at].1)
    }

    /// Value of a register that a datagram can write.
    pub fn writable(&mut self, register: u8) -> Option<&mut u32> {
        let at = self.index(register).filter(|at| self.table[*at].2)?;
        (self.stuck != Some(register)).then(|| &mut self.values[at])
    }
}

/// The power stage of a chip.
#[derive(Debug, Clone)]
pub struct PowerStage {
    /// Temperature at which it switches its motor off, C.
    shutdown_c: f64,
    celsius: f64,
    /// A phase of the motor is shorted to ground.
    shorted: bool,
    /// It switched its motor off because of its temperature.
    pub overheated: bool,
    /// It switched its motor off because of a short.
    pub switched_off: bool,
}

impl PowerStage {
    /// A stage at 40 C without a short.
    pub const fn new(shutdown_c: f64) -> Self {
        Self {
            shutdown_c,
            celsius: 40.0,
            shorted: false,
            overheated: false,
            switched_off: false,
        }
    }

    /// Temperature of the chip, C. Above its limit the stage switches the motor off, until it is
    /// cold enough for no warning. Returns whether it is above the limit.
    pub fn set_temperature(&mut self, celsius: f64) -> bool {
        self.celsius = celsius;
        let is_above = celsius >= self.shutdown_c;
        self.overheated = is_above || self.overheated && self.is_hot();
        is_above
    }

    /// The chip has at least this temperature, C.
    pub fn is_at(&self, celsius: f64) -> bool {
        self.celsius >= celsius
    }

    /// The chip warns.
    pub fn is_hot(&self) -> bool {
        self.is_at(WARNING_C)
    }

    /// A phase of the motor is shorted to ground, or not any more.
    pub const fn set_shorted(&mut self, shorted: bool) {
        self.shorted = shorted;
    }

    /// Looks for a short, which the stage sees while it is on. Returns whether it sees one.
    pub const fn find_short(&mut self, is_on: bool) -> bool {
        self.switched_off = is_on && (self.switched_off || self.shorted);
        is_on && self.shorted
    }

    /// It has not switched its motor off.
    pub const fn is_sound(&self) -> bool {
        !self.overheated && !self.switched_off
    }
}
