//! The byte-order mark that editors and exporters on Windows put before a text of UTF-8.

/// A text without it: what the first line begins with would have another name else.
pub(crate) fn unmarked(text: &[u8]) -> &[u8] {
    text.strip_prefix(b"\xef\xbb\xbf").unwrap_or(text)
}
