//! Licence and author, from where files say them.

use serde_json::Value;

use super::document::Document;
use crate::Rights;

/// The VRM block knows best; then the `extras` that model portals write; then `asset.copyright`.
/// What has another type than the format asks for counts as absent.
pub(super) fn read(document: &Document) -> Rights {
    let mut rights = vrm1(&document.extensions["VRMC_vrm"]["meta"]);
    rights.fill_from(vrm0(&document.extensions["VRM"]["meta"]));
    rights.fill_from(portal(&document.asset.extras));
    rights.fill_from(Rights { author: text(&document.asset.copyright), ..Rights::default() });
    rights
}

impl Rights {
    fn fill_from(&mut self, other: Self) {
        let Self { licence, author, notes } = other;
        for (own, other) in [(&mut self.licence, licence), (&mut self.author, author)] {
            if own.is_empty() {
                *own = other;
            }
        }
        self.notes.extend(notes);
    }
}

/// VRM 1.0.
fn vrm1(meta: &Value) -> Rights {
    let authors: Vec<_> =
        meta["authors"].as_array().into_iter().flatten().map(text).filter(|a| !a.is_empty()).collect();
    // The first of the two is the same VRM licence in nearly all files; the other is the author's choice.
    let licence = [&meta["otherLicenseUrl"], &meta["licenseUrl"]].map(text).into_iter().find(|l| !l.is_empty());
    Rights { licence: licence.map(|l| spdx(&l)).unwrap_or_default(), author: authors.join(", "), notes: vec![] }
}

/// VRM 0.x, whose licences are names of its own.
fn vrm0(meta: &Value) -> Rights {
    let licence = match text(&meta["licenseName"]).as_str() {
        "CC0" => "CC0-1.0".into(),
        "Other" => spdx(&text(&meta["otherLicenseUrl"])),
        name => match name.strip_prefix("CC_") {
            Some(terms) => format!("CC-{}-4.0", terms.replace('_', "-")),
            None => name.to_owned(),
        },
    };
    Rights { licence, author: text(&meta["author"]), notes: vec![] }
}

/// What Sketchfab and its like write: `"license": "CC-BY-4.0 (http://...)"`.
fn portal(extras: &Value) -> Rights {
    let source = text(&extras["source"]);
    Rights {
        licence: spdx(&text(&extras["license"])),
        author: text(&extras["author"]),
        notes: if source.is_empty() { vec![] } else { vec![format!("published at {source}")] },
    }
}

/// The SPDX name of a Creative Commons address or of a name with its address in brackets; else as stated.
fn spdx(stated: &str) -> String {
    if let Some((name, _)) = stated.split_once(" (http") {
        return name.to_owned();
    }
    let Some((_, path)) = stated.split_once("creativecommons.org/") else { return stated.to_owned() };
    match path.split('/').collect::<Vec<_>>()[..] {
        ["licenses", terms, version, ..] => format!("CC-{}-{version}", terms.to_uppercase()),
        ["publicdomain", "zero", version, ..] => format!("CC0-{version}"),
        _ => stated.to_owned(),
    }
}

/// A string, trimmed; empty for anything else.
fn text(value: &Value) -> String {
    value.as_str().unwrap_or_default().trim().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn licences_become_spdx_names_where_they_are_known() {
        for (stated, expected) in [
            ("CC-BY-4.0 (http://creativecommons.org/licenses/by/4.0/)", "CC-BY-4.0"),
            ("https://creativecommons.org/licenses/by-nc-sa/3.0/", "CC-BY-NC-SA-3.0"),
            ("https://creativecommons.org/publicdomain/zero/1.0/", "CC0-1.0"),
            ("https://creativecommons.org/", "https://creativecommons.org/"),
            ("https://vrm.dev/licenses/1.0/", "https://vrm.dev/licenses/1.0/"),
        ] {
            assert_eq!(spdx(stated), expected);
        }
        assert_eq!(vrm0(&json!({"licenseName": "CC_BY_NC", "author": " me "})).licence, "CC-BY-NC-4.0");
        assert_eq!(vrm0(&json!({"licenseName": "Redistribution_Prohibited"})).licence, "Redistribution_Prohibited");
        assert_eq!(vrm1(&json!({"authors": ["a", 3, "b"], "licenseUrl": "x"})).author, "a, b");
    }

    #[test]
    fn wrong_types_count_as_absent() {
        assert_eq!(vrm0(&json!("meta")), Rights::default());
        assert_eq!(vrm1(&json!([1, 2])), Rights::default());
        assert_eq!(portal(&json!({"license": {"a": 1}, "author": 5})), Rights::default());
    }
}
