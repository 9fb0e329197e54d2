//! Hash of all message types.
//!
//! Two builds that disagree on a field would misread each other's bytes, and postcard would not
//! detect it. Hello and Welcome carry this hash; a session between different hashes is refused.

use crate::message::{
    CONFIG_CHUNK, Hello, MAX_AXES, PROTOCOL_VERSION, RATE_SHIFT, Report, Request, SETPOINT_BATCH,
    Welcome,
};
use postcard_schema::Schema;
use postcard_schema::key::Key;

/// FNV-1a (64 bits) of the names and types of every field of every message, and of the limits that
/// the types do not contain.
pub const SCHEMA_HASH: u64 = {
    let mut hash = of::<Hello>("hello");
    hash = mix(hash, of::<Welcome>("welcome"));
    hash = mix(hash, of::<Request>("request"));
    hash = mix(hash, of::<Report>("report"));
    hash = mix(hash, PROTOCOL_VERSION as u64);
    hash = mix(hash, MAX_AXES as u64);
    hash = mix(hash, RATE_SHIFT as u64);
    hash = mix(hash, CONFIG_CHUNK as u64);
    mix(hash, SETPOINT_BATCH as u64)
};

/// Returns [`SCHEMA_HASH`], which is computed at build time.
pub const fn schema_hash() -> u64 {
    SCHEMA_HASH
}

/// Returns the hash of one message.
const fn of<T: Schema>(path: &str) -> u64 {
    u64::from_le_bytes(Key::for_path::<T>(path).to_bytes())
}

/// Adds a value to a hash, byte by byte (FNV-1a).
const fn mix(mut hash: u64, value: u64) -> u64 {
    let bytes = value.to_le_bytes();
    let mut index = 0;
    while index < bytes.len() {
        hash = (hash ^ bytes[index] as u64).wrapping_mul(0x0000_0100_0000_01b3);
        index += 1;
    }
    hash
}

#[cfg(test)]
mod tests {
    use super::*;
    use postcard_schema::schema::{DataModelType, DataModelVariant, NamedType};

    /// Writes every type name, field and variant below a type as text.
    fn text(named: &NamedType, out: &mut std::string::String) {
        text_of(named.ty, out);
    }

    fn text_of(ty: &DataModelType, out: &mut std::string::String) {
        match ty {
            DataModelType::Option(inner)
            | DataModelType::NewtypeStruct(inner)
            | DataModelType::Seq(inner) => {
                out.push('[');
                text(inner, out);
                out.push(']');
            }
            DataModelType::Tuple(all) | DataModelType::TupleStruct(all) => {
                all.iter().for_each(|t| text(t, out))
            }
            DataModelType::Struct(fields) => {
                for field in *fields {
                    out.push_str(field.name);
                    text(field.ty, out);
                }
            }
            DataModelType::Enum(variants) => {
                for variant in *variants {
                    out.push_str(variant.name);
                    match variant.ty {
                        DataModelVariant::UnitVariant => {}
                        DataModelVariant::NewtypeVariant(inner) => text(inner, out),
                        DataModelVariant::TupleVariant(all) => {
                            all.iter().for_each(|t| text(t, out))
                        }
                        DataModelVariant::StructVariant(fields) => {
                            for field in *fields {
                                out.push_str(field.name);
                                text(field.ty, out);
                            }
                        }
                    }
                }
            }
            other => out.push_str(&std::format!("{other:?}")),
        }
    }

    /// The hash covers every message: types that are easily forgotten are reachable from its roots.
    #[test]
    fn the_roots_reach_every_message() {
        let mut all = std::string::String::new();
        for root in [
            Hello::SCHEMA,
            Welcome::SCHEMA,
            Request::SCHEMA,
            Report::SCHEMA,
        ] {
            text(root, &mut all);
        }
        for part in [
            "residuals",
            "epoch",
            "HomingProblem",
            "following_error",
            "Backlash",
            "NearSingularity",
            "JogLimited",
            "config_crc",
            "ForceLoop",
            "AgainstMotion",
            "DampingTooSmall",
            "WrongSign",
            "TareRefused",
            "Interrupted",
            "displacement",
            "NotTared",
            "age_ms",
            "damping_below",
            "Singular",
            "FixturesTooNear",
            "feedback",
            "ForceSettings",
        ] {
            if part == "HomingProblem" {
                assert!(all.contains("NoIndex"));
            } else {
                assert!(all.contains(part), "{part} is outside the hash");
            }
        }
    }

    /// Adding, renaming, moving or retyping a field changes the hash, and so does the same change
    /// of a variant.
    #[test]
    fn any_change_of_shape_changes_the_hash() {
        #[derive(Schema)]
        #[allow(dead_code)]
        struct Before {
            a: u8,
            b: Kind,
        }
        #[derive(Schema)]
        #[allow(dead_code)]
        enum Kind {
            One,
            Two(u16),
        }
        mod renamed {
            #[derive(postcard_schema::Schema)]
            #[allow(dead_code)]
            pub struct After {
                pub a: u8,
                pub c: super::Kind2,
            }
        }
        mod added {
            #[derive(postcard_schema::Schema)]
            #[allow(dead_code)]
            pub struct After {
                pub a: u8,
                pub b: super::Kind2,
                pub c: bool,
            }
        }
        mod retyped {
            #[derive(postcard_schema::Schema)]
            #[allow(dead_code)]
            pub struct After {
                pub a: i8,
                pub b: super::Kind2,
            }
        }
        mod variant {
            #[derive(postcard_schema::Schema)]
            #[allow(dead_code)]
            pub struct After {
                pub a: u8,
                pub b: super::Kind3,
            }
        }
        mod same {
            #[derive(postcard_schema::Schema)]
            #[allow(dead_code)]
            pub struct After {
                pub a: u8,
                pub b: super::Kind2,
            }
        }
        let before = of::<Before>("x");
        assert_eq!(before, of::<same::After>("x"));
        let others = [
            of::<renamed::After>("x"),
            of::<added::After>("x"),
            of::<retyped::After>("x"),
            of::<variant::After>("x"),
            of::<Before>("y"),
        ];
        for (index, other) in others.iter().enumerate() {
            assert_ne!(before, *other, "{index}");
        }
        assert_ne!(mix(before, 6), mix(before, 5));
    }
    #[derive(Schema)]
    #[allow(dead_code)]
    enum Kind2 {
        One,
        Two(u16),
    }
    #[derive(Schema)]
    #[allow(dead_code)]
    enum Kind3 {
        Two(u16),
        One,
    }
}
