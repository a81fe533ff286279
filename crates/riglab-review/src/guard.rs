//! Who is answered: a browser on this machine that was given the address.

use subtle::ConstantTimeEq;

use crate::ReviewError;
use crate::http::{Answer, Request};

/// Letters of a token: 192 random bits, 6 a letter.
const LETTERS: usize = 32;
const ALPHABET: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_";

/// The secret in the address.
pub struct Token(String);

impl Token {
    /// A new one.
    ///
    /// # Errors
    /// When the system has no random numbers.
    pub fn new() -> Result<Self, ReviewError> {
        let mut bytes = [0; LETTERS];
        getrandom::fill(&mut bytes).map_err(|e| ReviewError::Random(e.to_string()))?;
        Ok(Self(bytes.iter().map(|b| char::from(ALPHABET[usize::from(b & 63)])).collect()))
    }

    /// As it stands in the address.
    pub fn text(&self) -> &str {
        &self.0
    }

    /// Compares in a time that does not tell how much of a guess is right.
    fn is(&self, guess: &str) -> bool {
        self.0.as_bytes().ct_eq(guess.as_bytes()).into()
    }
}

/// Lets a request through, and gives what it asks for below the token; or the refusal.
///
/// In this order: the name by which the machine was called (a page of another host whose name was rebound to
/// 127.0.0.1 sends its own), who asks (a browser tells for other sites' pages), the token.
pub fn admit<'a>(request: &'a Request, token: &Token) -> Result<&'a str, Answer> {
    let refuse = |text| Err(Answer::refusal(403, text));
    let host = request.header("host")?.unwrap_or_default();
    // Any port: it may be forwarded.
    let (name, port) = host.split_once(':').unwrap_or((host, "80"));
    let named = matches!(name, "127.0.0.1" | "localhost");
    if !named || port.is_empty() || port.len() > 5 || !port.bytes().all(|b| b.is_ascii_digit()) {
        return refuse("this page is for 127.0.0.1 alone");
    }
    let origin = request.header("origin")?;
    if origin.is_some_and(|origin| origin.strip_prefix("http://") != Some(host)) {
        return refuse("this page is not for other sites");
    }
    // Where it is sent, `none` is a person who opens the address.
    if !matches!(request.header("sec-fetch-site")?, None | Some("same-origin" | "none")) {
        return refuse("this page is not for other sites");
    }
    if request.method == "POST" && origin.is_none() {
        return refuse("what is written needs to say which page it is from");
    }
    let (guess, rest) = request.target.strip_prefix('/').and_then(|t| t.split_once('/')).unwrap_or_default();
    if !token.is(guess) {
        return refuse("the address is not complete: open the one that `riglab review` printed");
    }
    Ok(rest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tokens_are_long_and_their_own() {
        let (a, b) = (Token::new().unwrap(), Token::new().unwrap());
        assert!(a.text().len() == LETTERS && a.text() != b.text());
        assert!(a.is(a.text()) && !a.is(b.text()) && !a.is("") && !a.is(&a.text()[1..]));
        assert!(a.text().bytes().all(|c| ALPHABET.contains(&c)));
    }
}
