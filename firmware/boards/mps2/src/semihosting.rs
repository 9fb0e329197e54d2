//! Semihosting: files of the emulating computer for the link to the simulated machine, and the
//! console.
//!
//! While a call waits, the emulated processor and its time stand still, so the PIL link is exact.

use core::arch::asm;

const OPEN: usize = 0x01;
const WRITE_TEXT: usize = 0x04;
const WRITE: usize = 0x05;
const READ: usize = 0x06;
const COMMAND_LINE: usize = 0x15;
const EXIT: usize = 0x20;

/// The reason "the application ended", with an exit code.
const APPLICATION_EXIT: usize = 0x2_0026;

/// Makes one semihosting call. The emulator may write to `arguments`.
#[inline(always)]
fn call(operation: usize, arguments: *const usize) -> isize {
    let result: isize;
    // SAFETY: every caller below passes what the operation reads: the address of its arguments, or
    // of a text that ends with a zero. Memory that the emulator writes (READ) is borrowed mutably
    // during the call.
    unsafe {
        asm!("bkpt 0xAB", inout("r0") operation as isize => result, in("r1") arguments, options(nostack));
    }
    result
}

/// Error: the other end of a file was closed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Gone;

/// An open file.
#[derive(Debug)]
pub struct File {
    handle: usize,
}

impl File {
    fn open(name: &core::ffi::CStr, mode: usize) -> Result<Self, Gone> {
        let arguments = [name.as_ptr() as usize, mode, name.count_bytes()];
        usize::try_from(call(OPEN, arguments.as_ptr()))
            .map(|handle| Self { handle })
            .map_err(|_| Gone)
    }

    /// Opens a file for reading.
    ///
    /// # Errors
    /// The file does not exist.
    pub fn reader(name: &core::ffi::CStr) -> Result<Self, Gone> {
        Self::open(name, 0)
    }

    /// Opens a file for writing.
    ///
    /// # Errors
    /// The file cannot be created.
    pub fn writer(name: &core::ffi::CStr) -> Result<Self, Gone> {
        Self::open(name, 4)
    }

    /// Reads until `words` are full, each little endian.
    ///
    /// # Errors
    /// The file ends before.
    pub fn read(&mut self, words: &mut [u32]) -> Result<(), Gone> {
        let (start, length) = (words.as_mut_ptr() as usize, size_of_val(words));
        let mut done = 0;
        while done < length {
            let left = length - done;
            let arguments = [self.handle, start + done, left];
            let missing = call(READ, arguments.as_ptr()) as usize;
            if missing >= left {
                return Err(Gone);
            }
            done += left - missing;
        }
        Ok(())
    }

    /// Writes all of `words`, each little endian.
    ///
    /// # Errors
    /// No reader is left.
    pub fn write(&mut self, words: &[u32]) -> Result<(), Gone> {
        let arguments = [self.handle, words.as_ptr() as usize, size_of_val(words)];
        match call(WRITE, arguments.as_ptr()) {
            0 => Ok(()),
            _ => Err(Gone),
        }
    }
}

/// Returns the image's command line; empty when it does not fit into `room`.
pub fn command_line(room: &mut [u8]) -> &str {
    let mut arguments = [room.as_mut_ptr() as usize, room.len()];
    // Through a mutable pointer: the emulator writes the length.
    if call(COMMAND_LINE, arguments.as_mut_ptr()) != 0 {
        return "";
    }
    // The emulator writes the length, which the compiler cannot know.
    let length = core::hint::black_box(arguments)[1].min(room.len());
    let text = &room[..length];
    core::str::from_utf8(text)
        .unwrap_or("")
        .trim_end_matches('\0')
}

/// Writes to the emulator's console.
pub fn console(text: &core::ffi::CStr) {
    call(WRITE_TEXT, text.as_ptr().cast());
}

/// Ends the emulator with an exit code.
pub fn exit(code: u8) -> ! {
    let arguments = [APPLICATION_EXIT, usize::from(code)];
    call(EXIT, arguments.as_ptr());
    loop {
        cortex_m::asm::nop();
    }
}
