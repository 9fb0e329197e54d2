//! The token of a served port: a shared secret in the first line of a connection.
//!
//! Token and data are not encrypted: on a network that is not trusted, callers must use a tunnel
//! (ssh -L).

use sha2::{Digest, Sha256};
use std::fmt;
use std::str::FromStr;
use std::sync::OnceLock;

/// Start of the first line of a connection to a port that requires a token.
pub(super) const TOKEN_PREFIX: &[u8] = b"haptimill-token ";

/// Length of a token, characters.
const LENGTHS: std::ops::RangeInclusive<usize> = 16..=128;

/// Length of the first line at most, bytes.
pub(super) const LONGEST_LINE: usize = TOKEN_PREFIX.len() + *LENGTHS.end() + 1;

/// Environment variable with the token of a client.
pub const TOKEN_VARIABLE: &str = "HAPTIMILL_TOKEN";

/// A token: 16 to 128 visible ASCII characters.
#[derive(Clone, PartialEq, Eq)]
pub struct Token(String);

impl FromStr for Token {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if LENGTHS.contains(&text.len()) && text.bytes().all(|byte| byte.is_ascii_graphic()) {
            Ok(Self(text.to_string()))
        } else {
            let (low, high) = (LENGTHS.start(), LENGTHS.end());
            Err(format!(
                "a token has {low} to {high} visible ASCII characters and no space"
            ))
        }
    }
}

impl fmt::Debug for Token {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str("Token(..)")
    }
}

impl Token {
    /// A new token of 128 random bits.
    ///
    /// # Errors
    /// The system gives no random numbers.
    pub fn random() -> Result<Self, String> {
        let mut bytes = [0; 16];
        getrandom::fill(&mut bytes).map_err(|error| error.to_string())?;
        Ok(Self(
            bytes.iter().map(|byte| format!("{byte:02x}")).collect(),
        ))
    }

    /// The text of the token.
    #[must_use]
    pub fn reveal(&self) -> &str {
        &self.0
    }

    pub(super) fn digest(&self) -> [u8; 32] {
        Sha256::digest(self.0.as_bytes()).into()
    }

    /// The first line of a connection. A port that requires no token takes it for a corrupt frame,
    /// which the zero ends.
    pub(super) fn line(&self) -> Vec<u8> {
        [TOKEN_PREFIX, self.0.as_bytes(), b"\n\0"].concat()
    }
}

/// The token of this process.
static TOKEN: OnceLock<Token> = OnceLock::new();

/// Sends this token to every TCP port that is opened from now on; only the first call has an
/// effect.
pub fn use_token(token: Token) {
    let _ = TOKEN.set(token);
}

/// The token of this process.
pub(super) fn token() -> Option<&'static Token> {
    TOKEN.get()
}
