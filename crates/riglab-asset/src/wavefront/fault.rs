//! Where an OBJ is wrong. tobj, which refuses it, tells neither line nor word.

use super::joined;
use crate::Fault;
use crate::marked::unmarked;

/// What is wrong with the first line of places and faces that is no sound one; `otherwise` where all are.
pub(crate) fn explain(bytes: &[u8], otherwise: &str) -> Fault {
    let text = String::from_utf8_lossy(unmarked(bytes));
    let all = joined(&text).filter(|(_, line)| line.split_whitespace().next() == Some("v")).count();
    let mut before = 0;
    for (number, line) in joined(&text) {
        let mut words = line.split_whitespace();
        let wrong = match words.next() {
            Some("v") => {
                before += 1;
                place(words)
            }
            Some("f") => words.find_map(|word| corner(word, before, all)),
            _ => None,
        };
        if let Some(wrong) = wrong {
            return Fault::Obj(format!("line {number}: {wrong}"));
        }
    }
    Fault::Obj(otherwise.into())
}

/// What is wrong with the words of a place.
fn place<'a>(words: impl Iterator<Item = &'a str>) -> Option<String> {
    let mut count = 0;
    for word in words.take(3) {
        if !word.parse::<f32>().is_ok_and(f32::is_finite) {
            return Some(format!("`{}` is no coordinate, which is a finite number", shown(word)));
        }
        count += 1;
    }
    (count < 3).then(|| format!("a vertex has {count} coordinates, not 3"))
}

/// What is wrong with a corner of a face that has `before` of `all` vertices before it.
fn corner(word: &str, before: usize, all: usize) -> Option<String> {
    let mut parts = word.split('/');
    let vertex = parts.next().and_then(|part| part.parse::<i64>().ok());
    let sound = parts.all(|part| part.is_empty() || part.parse::<i64>().is_ok());
    let within = |most: usize, number: i64| number.unsigned_abs() <= most as u64;
    match vertex.filter(|_| sound) {
        None => Some(format!(
            "`{}` is no corner of a face, which is the number of a vertex (and of a texture coordinate and a normal, \
             `1/2/3`); there are {all} vertices",
            shown(word)
        )),
        Some(0) => Some(format!("`{}` names vertex 0, but they count from 1; there are {all}", shown(word))),
        Some(number) if number > 0 && !within(all, number) => {
            Some(format!("`{}` names vertex {number}, there are {all}", shown(word)))
        }
        Some(number) if number < 0 && !within(before, number) => Some(format!(
            "`{}` counts {} vertices back, there are {before} before it",
            shown(word),
            number.unsigned_abs()
        )),
        Some(_) => None,
    }
}

/// The beginning of a word, which may be of any length.
fn shown(word: &str) -> String {
    word.chars().take(40).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_wrong_word_is_told_with_its_line() {
        let of = |text: &str| match explain(text.as_bytes(), "otherwise") {
            Fault::Obj(reason) => reason,
            other => panic!("{other}"),
        };
        let all = "# a\nv 0 0 0\nv 1 0 0\nv 0 1 0\n";
        assert!(of(&format!("{all}f 1 2 x")).starts_with("line 5: `x` is no corner of a face"));
        assert!(of(&format!("{all}f 1 2/a 3")).starts_with("line 5: `2/a` is no corner of a face"));
        assert_eq!(of(&format!("{all}f 1 2 9/1")), "line 5: `9/1` names vertex 9, there are 3");
        assert_eq!(of(&format!("{all}f 1 2 0")), "line 5: `0` names vertex 0, but they count from 1; there are 3");
        assert_eq!(
            of(&format!("{all}f 1 2 -4\nv 0 0 0")),
            "line 5: `-4` counts 4 vertices back, there are 3 before it"
        );
        assert_eq!(of("v 0 0\nv a b c"), "line 1: a vertex has 2 coordinates, not 3");
        assert_eq!(of("v 0 0 0\nv 1 0 q"), "line 2: `q` is no coordinate, which is a finite number");
        assert_eq!(of("v 0 0 inf"), "line 1: `inf` is no coordinate, which is a finite number");
        // Of lines that go on, the number of the first.
        assert_eq!(of("v 0 \\\n 0 \\\n0\nv 0 \\\n y 0"), "line 4: `y` is no coordinate, which is a finite number");
        assert_eq!(of(&format!("{all}f 1/2/3 2//1 -1\nf 1 2 3 1")), "otherwise");
    }
}
