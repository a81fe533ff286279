//! Paths of keys: `model.width`, `data.sources[1].path`, `a."odd key"`.

/// One step of a path.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Step {
    Key(String),
    Index(usize),
}

/// The path of a key in the table at `path`; the root's path is empty.
pub(crate) fn join(path: &str, key: &str) -> String {
    match path {
        "" => quoted(key),
        _ => format!("{path}.{}", quoted(key)),
    }
}

/// A key as TOML writes it.
pub(crate) fn quoted(key: &str) -> String {
    let bare = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    if !key.is_empty() && key.chars().all(bare) { key.to_owned() } else { quoted_string(key) }
}

/// A text as a one-line TOML string.
pub(crate) fn quoted_string(text: &str) -> String {
    let mut out = String::from("\"");
    for c in text.chars() {
        match c {
            '"' => out.push_str("\\\""),
            '\\' => out.push_str("\\\\"),
            '\n' => out.push_str("\\n"),
            '\r' => out.push_str("\\r"),
            '\t' => out.push_str("\\t"),
            c if c.is_control() => out.push_str(&format!("\\u{:04X}", c as u32)),
            c => out.push(c),
        }
    }
    out + "\""
}

/// Splits a path. Whatever is not understood is taken as part of a key: such a path is not found.
pub(crate) fn steps(path: &str) -> Vec<Step> {
    let mut steps = Vec::new();
    let mut rest = path;
    while !rest.is_empty() {
        if let Some((index, after)) = rest.strip_prefix('[').and_then(|r| r.split_once(']'))
            && let Ok(index) = index.parse()
        {
            steps.push(Step::Index(index));
            rest = after.strip_prefix('.').unwrap_or(after);
        } else if let Some((key, after)) = rest.strip_prefix('"').and_then(unquote) {
            steps.push(Step::Key(key));
            rest = after.strip_prefix('.').unwrap_or(after);
        } else {
            let mut ends = rest.char_indices().skip(1).filter(|(_, c)| matches!(c, '.' | '['));
            let end = ends.next().map_or(rest.len(), |(at, _)| at);
            steps.push(Step::Key(rest[..end].to_owned()));
            rest = rest[end..].strip_prefix('.').unwrap_or(&rest[end..]);
        }
    }
    steps
}

/// The content of a string after its opening quote, and what follows its closing one.
fn unquote(text: &str) -> Option<(String, &str)> {
    let mut escaped = false;
    let end = text.find(|c| {
        let closes = c == '"' && !escaped;
        escaped = c == '\\' && !escaped;
        closes
    })?;
    let value = toml::de::DeValue::parse(&format!("\"{}\"", &text[..end])).ok()?.into_inner().as_str()?.to_owned();
    Some((value, &text[end + 1..]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn joined_paths_split_into_their_keys() {
        let keys = ["model", "odd key", "", "a.b", "x\"\\\n\u{1}é", "[0]"];
        let path = keys.iter().fold(String::new(), |path, key| join(&path, key));
        assert_eq!(steps(&path), keys.map(|k| Step::Key(k.into())));
        let steps = steps("data.sources[12].path");
        assert_eq!(steps[2], Step::Index(12));
        assert_eq!(steps.len(), 4);
    }

    #[test]
    fn odd_paths_do_not_panic() {
        for path in [".", "..", "a.", "[", "[x]", "\"", "\"a", "é.é", "]", "[1", ".[1]"] {
            steps(path);
        }
    }
}
