//! Serialisation of a message to bytes, in the format of postcard.
//!
//! The serializer of postcard writes each number to a buffer of its own and copies it from there
//! byte by byte. That costs 100 instructions a number, and telemetry has forty numbers. This one
//! writes each byte in place and checks once, at the end, whether all of them fitted. The bytes are
//! the same (a test compares every message with postcard), and postcard reads them.
//!
//! Types that no message has are refused: floats, characters, maps, numbers of 128 bits.

use core::fmt::{self, Display};
use serde::ser::{self, Impossible, Serialize, Serializer};

/// Writes a message as far as it fits into `room`, and returns its whole length in bytes. Returns
/// `None` for a type that no message has.
pub(crate) fn write(message: &impl Serialize, room: &mut [u8]) -> Option<usize> {
    let mut wire = Wire { room, at: 0 };
    message.serialize(&mut wire).ok()?;
    Some(wire.at)
}

/// Output buffer. Bytes beyond its end are only counted.
struct Wire<'a> {
    room: &'a mut [u8],
    at: usize,
}

/// Error: a type that no message has.
#[derive(Debug)]
struct Foreign;

impl Display for Foreign {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("no message has this")
    }
}

impl core::error::Error for Foreign {}

impl ser::Error for Foreign {
    fn custom<T: Display>(_: T) -> Self {
        Self
    }
}

impl Wire<'_> {
    fn byte(&mut self, byte: u8) {
        if let Some(place) = self.room.get_mut(self.at) {
            *place = byte;
        }
        // No message is as long as the address space.
        self.at = self.at.wrapping_add(1);
    }

    /// Writes seven bits a byte, lowest first.
    #[inline(never)]
    fn number(&mut self, number: u32) {
        let mut number = number;
        while number >= 0x80 {
            self.byte(number as u8 | 0x80);
            number >>= 7;
        }
        self.byte(number as u8);
    }

    #[inline(never)]
    fn long(&mut self, number: u64) {
        let mut number = number;
        while number > u64::from(u32::MAX) {
            self.byte(number as u8 | 0x80);
            number >>= 7;
        }
        self.number(number as u32);
    }

    fn signed(&mut self, number: i32) {
        self.number(((number << 1) ^ (number >> 31)) as u32);
    }

    fn bytes(&mut self, bytes: &[u8]) {
        self.number(bytes.len() as u32);
        for &byte in bytes {
            self.byte(byte);
        }
    }
}

impl<'a, 'b> Serializer for &'a mut Wire<'b> {
    type Ok = ();
    type Error = Foreign;
    type SerializeSeq = Self;
    type SerializeTuple = Self;
    type SerializeTupleStruct = Self;
    type SerializeTupleVariant = Self;
    type SerializeMap = Impossible<(), Foreign>;
    type SerializeStruct = Self;
    type SerializeStructVariant = Self;

    fn is_human_readable(&self) -> bool {
        false
    }

    fn serialize_bool(self, value: bool) -> Result<(), Foreign> {
        self.byte(u8::from(value));
        Ok(())
    }

    fn serialize_i8(self, value: i8) -> Result<(), Foreign> {
        self.byte(value as u8);
        Ok(())
    }

    fn serialize_i16(self, value: i16) -> Result<(), Foreign> {
        self.signed(i32::from(value));
        Ok(())
    }

    fn serialize_i32(self, value: i32) -> Result<(), Foreign> {
        self.signed(value);
        Ok(())
    }

    fn serialize_i64(self, value: i64) -> Result<(), Foreign> {
        self.long(((value << 1) ^ (value >> 63)) as u64);
        Ok(())
    }

    fn serialize_u8(self, value: u8) -> Result<(), Foreign> {
        self.byte(value);
        Ok(())
    }

    fn serialize_u16(self, value: u16) -> Result<(), Foreign> {
        self.number(u32::from(value));
        Ok(())
    }

    fn serialize_u32(self, value: u32) -> Result<(), Foreign> {
        self.number(value);
        Ok(())
    }

    fn serialize_u64(self, value: u64) -> Result<(), Foreign> {
        self.long(value);
        Ok(())
    }

    fn serialize_f32(self, _: f32) -> Result<(), Foreign> {
        Err(Foreign)
    }

    fn serialize_f64(self, _: f64) -> Result<(), Foreign> {
        Err(Foreign)
    }

    fn serialize_char(self, _: char) -> Result<(), Foreign> {
        Err(Foreign)
    }

    fn serialize_str(self, text: &str) -> Result<(), Foreign> {
        self.bytes(text.as_bytes());
        Ok(())
    }

    fn serialize_bytes(self, bytes: &[u8]) -> Result<(), Foreign> {
        self.bytes(bytes);
        Ok(())
    }

    fn serialize_none(self) -> Result<(), Foreign> {
        self.byte(0);
        Ok(())
    }

    fn serialize_some<T: Serialize + ?Sized>(self, value: &T) -> Result<(), Foreign> {
        self.byte(1);
        value.serialize(self)
    }

    fn serialize_unit(self) -> Result<(), Foreign> {
        Ok(())
    }

    fn serialize_unit_struct(self, _: &'static str) -> Result<(), Foreign> {
        Ok(())
    }

    fn serialize_unit_variant(
        self,
        _: &'static str,
        index: u32,
        _: &'static str,
    ) -> Result<(), Foreign> {
        self.number(index);
        Ok(())
    }

    fn serialize_newtype_struct<T: Serialize + ?Sized>(
        self,
        _: &'static str,
        value: &T,
    ) -> Result<(), Foreign> {
        value.serialize(self)
    }

    fn serialize_newtype_variant<T: Serialize + ?Sized>(
        self,
        _: &'static str,
        index: u32,
        _: &'static str,
        value: &T,
    ) -> Result<(), Foreign> {
        self.number(index);
        value.serialize(self)
    }

    fn serialize_seq(self, length: Option<usize>) -> Result<Self, Foreign> {
        self.number(length.ok_or(Foreign)? as u32);
        Ok(self)
    }

    fn serialize_tuple(self, _: usize) -> Result<Self, Foreign> {
        Ok(self)
    }

    fn serialize_tuple_struct(self, _: &'static str, _: usize) -> Result<Self, Foreign> {
        Ok(self)
    }

    fn serialize_tuple_variant(
        self,
        _: &'static str,
        index: u32,
        _: &'static str,
        _: usize,
    ) -> Result<Self, Foreign> {
        self.number(index);
        Ok(self)
    }

    fn serialize_map(self, _: Option<usize>) -> Result<Self::SerializeMap, Foreign> {
        Err(Foreign)
    }

    fn serialize_struct(self, _: &'static str, _: usize) -> Result<Self, Foreign> {
        Ok(self)
    }

    fn serialize_struct_variant(
        self,
        _: &'static str,
        index: u32,
        _: &'static str,
        _: usize,
    ) -> Result<Self, Foreign> {
        self.number(index);
        Ok(self)
    }

    fn collect_str<T: Display + ?Sized>(self, _: &T) -> Result<(), Foreign> {
        Err(Foreign)
    }
}

/// The parts of a composite follow each other without separators or terminator.
macro_rules! parts {
    ($($kind:ident $function:ident $(($key:ty))?),*) => {$(
        impl ser::$kind for &mut Wire<'_> {
            type Ok = ();
            type Error = Foreign;

            fn $function<T: Serialize + ?Sized>(&mut self, $(_: $key,)? value: &T) -> Result<(), Foreign> {
                value.serialize(&mut **self)
            }

            fn end(self) -> Result<(), Foreign> {
                Ok(())
            }
        }
    )*};
}

parts!(
    SerializeSeq serialize_element,
    SerializeTuple serialize_element,
    SerializeTupleStruct serialize_field,
    SerializeTupleVariant serialize_field,
    SerializeStruct serialize_field (&'static str),
    SerializeStructVariant serialize_field (&'static str)
);

#[cfg(test)]
mod tests {
    use super::write;
    use crate::frame::MAX_PAYLOAD;
    use crate::message::{Hello, Report, Request, Welcome};
    use proptest::prelude::*;
    use serde::Serialize;
    use serde::de::DeserializeOwned;

    /// Checks that a message decoded from arbitrary bytes is written as postcard writes it, and
    /// that a shorter buffer gets the first part.
    fn same<T: Serialize + DeserializeOwned>(bytes: &[u8], room: usize) -> bool {
        let Ok(message) = postcard::from_bytes::<T>(bytes) else {
            return false;
        };
        let (mut theirs, mut ours) = ([0; 400], [0; 400]);
        let length = postcard::to_slice(&message, &mut theirs).unwrap().len();
        assert_eq!(write(&message, &mut ours), Some(length));
        assert_eq!(ours, theirs);
        let room = room.min(length);
        let mut ours = [0; 400];
        assert_eq!(write(&message, &mut ours[..room]), Some(length));
        assert_eq!(ours[..room], theirs[..room]);
        assert!(ours[room..].iter().all(|&byte| byte == 0));
        true
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 3_000, rng_seed: proptest::test_runner::RngSeed::Fixed(6), failure_persistence: None, ..ProptestConfig::default() })]

        #[test]
        fn writes_what_postcard_writes(
            kind in 0..34_u8,
            rest in prop::collection::vec(prop_oneof![2 => 0..6_u8, 1 => any::<u8>()], 60..200),
            room in 0..MAX_PAYLOAD,
        ) {
            let mut bytes = rest;
            same::<Hello>(&bytes, room);
            same::<Welcome>(&bytes, room);
            bytes[1] = kind;
            same::<Request>(&bytes, room);
            bytes[0] = kind % 4;
            same::<Report>(&bytes, room);
        }
    }
}
