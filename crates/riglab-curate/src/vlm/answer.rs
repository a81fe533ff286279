//! What an answer says.

use crate::Category;

/// The one category that an answer names, as a word of its own; `None` where it names none, or several.
/// Upper and lower case are alike, and `_`, `-` and blanks within a name.
pub fn category_in(answer: &str) -> Option<Category> {
    // One blank for everything between words, and one at both ends, so that whole words are found.
    let words: Vec<String> = answer
        .to_lowercase()
        .split(|c: char| !c.is_alphanumeric())
        .filter(|w| !w.is_empty())
        .map(String::from)
        .collect();
    let text = format!(" {} ", words.join(" "));
    let mut named = Category::ALL.into_iter().filter(|c| text.contains(&format!(" {} ", c.name().replace('_', " "))));
    match (named.next(), named.next()) {
        (Some(one), None) => Some(one),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_category_is_an_answer_and_none_or_two_are_not() {
        assert_eq!(category_in("quadruped"), Some(Category::Quadruped));
        assert_eq!(category_in("**Bird-Flying**.\n"), Some(Category::BirdFlying));
        assert_eq!(category_in("It is \"mechanical other\"!"), Some(Category::MechanicalOther));
        assert_eq!(category_in("humanoid or reptile"), None);
        assert_eq!(category_in("humanoids"), None);
        assert_eq!(category_in("a fine horse"), None);
        assert_eq!(category_in(""), None);
    }
}
