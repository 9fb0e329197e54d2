//! Who may use a served port: a word that both ends know, said in the first line of a connection.
//!
//! Misuse: the word goes over the network as it is, and so does all that follows. On a network that is not trusted, use a tunnel (ssh -L).

use sha2::{Digest, Sha256};
use std::fmt;
use std::str::FromStr;
use std::sync::OnceLock;

/// What the first line of a connection begins with where the port asks for a token.
pub(super) const TOKEN_WORD: &[u8] = b"haptimill-token ";

/// Lengths of a token, characters.
const LENGTHS: std::ops::RangeInclusive<usize> = 16..=128;

/// The longest first line, bytes.
pub(super) const LONGEST_LINE: usize = TOKEN_WORD.len() + *LENGTHS.end() + 1;

/// The environment variable from which a client takes its token.
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
    /// A new one, of 128 random bits.
    ///
    /// # Errors
    /// The system has no randomness.
    pub fn random() -> Result<Self, String> {
        let mut bytes = [0; 16];
        getrandom::fill(&mut bytes).map_err(|error| error.to_string())?;
        Ok(Self(
            bytes.iter().map(|byte| format!("{byte:02x}")).collect(),
        ))
    }

    /// The word itself, to be handed to whoever may use the port.
    #[must_use]
    pub fn reveal(&self) -> &str {
        &self.0
    }

    pub(super) fn digest(&self) -> [u8; 32] {
        Sha256::digest(self.0.as_bytes()).into()
    }

    /// The first line of a connection. A port that asks for no token takes it for a damaged frame, which the zero ends.
    pub(super) fn line(&self) -> Vec<u8> {
        [TOKEN_WORD, self.0.as_bytes(), b"\n\0"].concat()
    }
}

/// The token of this process for the ports that it opens.
static TOKEN: OnceLock<Token> = OnceLock::new();

/// Gives this token to every TCP port that is opened from now on; the first call counts.
pub fn use_token(token: Token) {
    let _ = TOKEN.set(token);
}

/// The token for ports that are opened.
pub(super) fn token() -> Option<&'static Token> {
    TOKEN.get()
}
