use std::ops::ControlFlow;

use super::super::budget::Budget;
use super::super::fault::PeerFault;
use super::{Id, Node, View, read};

fn whole(bytes: &[u8]) -> Result<(Vec<Node>, Id), PeerFault> {
    read("x", &mut &bytes[..], &mut Budget::of(bytes.len() as u64), None).map(Option::unwrap)
}

fn refusal(bytes: &[u8]) -> String {
    whole(bytes).unwrap_err().to_string()
}

#[test]
fn values_of_every_kind_are_built() {
    // (-2, 300, 7, 1.5, "é", b"ab", True, None, [1], {"k": 2})
    let mut bytes = b"\x80\x04(J\xfe\xff\xff\xffM\x2c\x01\x8a\x01\x07G\x3f\xf8\0\0\0\0\0\0".to_vec();
    bytes.extend(b"\x8c\x02\xc3\xa9C\x02ab\x88N]\x94K\x01a}\x8c\x01kK\x02st.");
    let (nodes, id) = whole(&bytes).unwrap();
    let all: Vec<View<'_>> = View { nodes: &nodes, id }.members().unwrap().collect();
    assert_eq!(all.iter().map(|v| v.int()).collect::<Vec<_>>()[..3], [Some(-2), Some(300), Some(7)]);
    assert!(matches!(all[3].node(), Node::Float(x) if *x == 1.5));
    assert_eq!(all[4].text(), Some("\u{e9}"));
    assert!(matches!(all[5].node(), Node::Bytes(b) if **b == *b"ab"));
    assert_eq!((all[6].int(), all[7].is_none()), (Some(1), true));
    assert_eq!(all[8].members().unwrap().next().unwrap().int(), Some(1));
    assert_eq!(all[9].get("k").and_then(View::int), Some(2));
}

#[test]
fn names_beyond_the_list_are_refused_and_told() {
    assert!(refusal(b"\x80\x04\x8c\x02os\x8c\x06system\x93.").contains("`os.system`"));
    assert!(refusal(b"cbuiltins\neval\n.").contains("`builtins.eval`"));
    // Known names may only be called for what they are.
    assert!(refusal(b"cnumpy\nndarray\n)R.").contains("it calls"));
    assert!(refusal(b"K\x01)R.").contains("it calls a number"));
}

#[test]
fn an_empty_text_of_numpy_is_one() {
    let bytes = b"cnumpy.core.multiarray\nscalar\ncnumpy\ndtype\n\x8c\x02U0\x89\x88\x87R(K\x03\x8c\x01<NNNK\0K\x04K\x08tbC\0\x86R.";
    let (nodes, id) = whole(bytes).unwrap();
    assert_eq!(View { nodes: &nodes, id }.text(), Some(""));
}

#[test]
fn broken_pickles_end_in_words() {
    let cases: [(&[u8], &str); 11] = [
        (b"", "ends early"),
        (b"N", "ends early"),
        (b".", "more values than there are"),
        (b"(t", "ends early"),
        (b"t.", "was not begun"),
        (b"(a.", "more values"),
        (b"h\x05.", "value 5 is used again"),
        (b"B\xff\xff\xff\xffx.", "more memory"),
        (b"X\xff\xff\0\0x.", "ends early"),
        (b"\x8a\x09123456789.", "more than 64 bits"),
        (b"i.", "instruction 0x69"),
    ];
    for (bytes, wanted) in cases {
        let found = refusal(bytes);
        assert!(found.contains(wanted), "{found} / {wanted}");
    }
}

#[test]
fn deep_nesting_and_cycles_cost_no_stack() {
    let mut bytes = vec![b']'; 1000];
    bytes.extend(vec![b'a'; 999]);
    bytes.push(b'.');
    assert!(whole(&bytes).is_ok());
    // A list that holds itself.
    assert!(whole(b"]\x94h\0a.").is_ok());
}

/// Two assets as `pickle` writes them: the second refers to the keys of the first.
const TWO: &[u8] = b"\x80\x04]\x94(}\x94(\x8c\x01a\x94K\x01\x8c\x01b\x94K\x02u}\x94(h\x02K\x03h\x03K\x04ue.";

/// What the keys `a` and `b` hold.
type Seen = (Option<i64>, Option<i64>);

fn streamed(bytes: &[u8], stop_after: usize) -> (Vec<Seen>, Result<bool, PeerFault>) {
    let mut out = Vec::new();
    let mut each = |v: View<'_>| {
        out.push((v.get("a").and_then(View::int), v.get("b").and_then(View::int)));
        if out.len() == stop_after { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    let done = read("x", &mut &bytes[..], &mut Budget::of(bytes.len() as u64), Some(&mut each));
    (out, done.map(|whole| whole.is_some()))
}

#[test]
fn members_come_one_by_one_and_keys_are_remembered() {
    let wanted = [(Some(1), Some(2)), (Some(3), Some(4))];
    assert_eq!(streamed(TWO, 9), (wanted.to_vec(), Ok(true)));
    assert_eq!(streamed(TWO, 1), (wanted[..1].to_vec(), Ok(false)));
    // One by one, as the last of a thousand and one is added.
    let single = b"\x80\x04]\x94}\x94(\x8c\x01a\x94K\x01\x8c\x01b\x94K\x02ua}\x94(h\x02K\x03h\x03K\x04ua.";
    assert_eq!(streamed(single, 9), (wanted.to_vec(), Ok(true)));
}

#[test]
fn a_small_tuple_that_members_share_is_remembered() {
    // [{"a": (5, 6)}] and, added by another batch, {"a": the same tuple}.
    let bytes = b"\x80\x04]\x94(}\x94\x8c\x01a\x94K\x05K\x06\x86\x94se(}\x94h\x02h\x03se.";
    let mut seen = Vec::new();
    let mut each = |v: View<'_>| {
        let shape = v.get("a").and_then(View::members).map(|m| m.filter_map(View::int).collect::<Vec<_>>());
        seen.push(shape);
        ControlFlow::Continue(())
    };
    read("x", &mut &bytes[..], &mut Budget::of(bytes.len() as u64), Some(&mut each)).unwrap();
    assert_eq!(seen, [Some(vec![5, 6]), Some(vec![5, 6])]);
}

#[test]
fn a_member_that_comes_again_is_not_handed_out_again() {
    // The same dictionary thrice, by reference.
    let bytes = b"\x80\x04]\x94(}\x94(\x8c\x01a\x94K\x01\x8c\x01b\x94K\x02uh\x01h\x01e.";
    let (seen, _) = streamed(bytes, 9);
    assert_eq!(seen.iter().filter(|(a, _)| a.is_some()).count(), 1);
}

#[test]
fn what_was_handed_out_takes_no_room() {
    // Eighty assets of 4,000 bytes each, while about 100,000 may be held.
    let mut bytes = b"\x80\x04]\x94(".to_vec();
    for _ in 0..80 {
        bytes.extend(b"}(\x8c\x01aK\x01\x8c\x01bB\xa0\x0f\0\0");
        bytes.extend([7; 4000]);
        bytes.push(b'u');
    }
    bytes.extend(b"e.");
    let mut seen = 0;
    let mut each = |_: View<'_>| {
        seen += 1;
        ControlFlow::Continue(())
    };
    read("x", &mut &bytes[..], &mut Budget::of(3000), Some(&mut each)).unwrap();
    assert_eq!(seen, 80);
}
