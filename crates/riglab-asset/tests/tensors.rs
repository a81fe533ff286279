//! Checkpoints of torch: every tensor as torch has it, nothing of what else is in them.

#[path = "common/peak.rs"]
mod peak;

use std::io::{Cursor, Read, Write};

use riglab_asset::{StoredKind, TensorFile};

/// Written by `data/lightning.py`.
const LIGHTNING: &[u8] = include_bytes!("data/lightning.ckpt");

fn open(bytes: &[u8]) -> Result<TensorFile<'_>, String> {
    TensorFile::from_bytes("a.ckpt", bytes).map_err(|e| e.to_string())
}

/// A tensor's numbers.
fn numbers(file: &mut TensorFile<'_>, name: &str) -> (StoredKind, Vec<usize>, Vec<f64>) {
    let t = file.read(name).unwrap().unwrap_or_else(|| panic!("no tensor {name}"));
    let size = match t.kind {
        StoredKind::F64 | StoredKind::I64 => 8,
        StoredKind::F32 | StoredKind::I32 => 4,
        StoredKind::F16 | StoredKind::Bf16 | StoredKind::I16 => 2,
        StoredKind::I8 | StoredKind::U8 | StoredKind::Bool => 1,
    };
    let number = |b: &[u8]| match t.kind {
        StoredKind::F64 => f64::from_le_bytes(b.try_into().unwrap()),
        StoredKind::F32 => f32::from_le_bytes(b.try_into().unwrap()).into(),
        StoredKind::F16 => half::f16::from_le_bytes(b.try_into().unwrap()).into(),
        StoredKind::Bf16 => half::bf16::from_le_bytes(b.try_into().unwrap()).into(),
        StoredKind::I64 => i64::from_le_bytes(b.try_into().unwrap()) as f64,
        StoredKind::I8 => f64::from(b[0] as i8),
        _ => f64::from(b[0]),
    };
    (t.kind, t.shape, t.bytes.chunks_exact(size).map(number).collect())
}

#[test]
fn tensors_of_a_lightning_checkpoint_are_read_and_all_else_is_read_over() {
    let mut file = open(LIGHTNING).unwrap();
    let names: Vec<&str> = file.shapes().map(|(name, _)| name).collect();
    // What is no tensor is not among them.
    assert_eq!(names.len(), 13, "{names:?}");
    assert!(!names.contains(&"model._extra_state"));
    let all: Vec<f64> = (0..24).map(f64::from).collect();
    let turned: Vec<f64> = (0..6).flat_map(|c| (0..4).map(move |r| f64::from(6 * r + c))).collect();
    for (name, kind, shape, wanted) in [
        ("model.whole.weight", StoredKind::F32, vec![4, 6], all.clone()),
        ("model.shared.rows", StoredKind::F32, vec![2, 6], all[6..18].to_vec()),
        ("model.turned.weight", StoredKind::F32, vec![6, 4], turned),
        ("model.column", StoredKind::F32, vec![4], vec![2.0, 8.0, 14.0, 20.0]),
        ("model.half", StoredKind::F16, vec![2], vec![1.5, -2.0]),
        ("model.brain", StoredKind::Bf16, vec![2], vec![1.5, -2.0]),
        ("model.double", StoredKind::F64, vec![1], vec![0.1]),
        ("model.count", StoredKind::I64, vec![], vec![7.0]),
        ("model.bytes", StoredKind::U8, vec![2], vec![250.0, 3.0]),
        ("model.signed", StoredKind::I8, vec![1], vec![-3.0]),
        ("model.flag", StoredKind::Bool, vec![2], vec![1.0, 0.0]),
        ("model.empty", StoredKind::F32, vec![0, 3], vec![]),
        ("model.parameter", StoredKind::F32, vec![1, 2], vec![0.5, -1.5]),
    ] {
        assert_eq!(numbers(&mut file, name), (kind, shape, wanted), "{name}");
    }
    assert_eq!(file.read("model.other"), Ok(None));
    assert_eq!(file.step(), Some(1400));
    assert_eq!(file.setting("tokens_per_skin"), Some(vec![4]));
    assert_eq!(file.setting("levels"), Some(vec![8, 8, 5]));
    assert_eq!(file.setting("other"), None);
}

/// The members of an archive.
fn members(bytes: &[u8]) -> Vec<(String, Vec<u8>)> {
    let mut zip = zip::ZipArchive::new(Cursor::new(bytes)).unwrap();
    let each = |at| {
        let mut file = zip.by_index(at).unwrap();
        let mut content = Vec::new();
        file.read_to_end(&mut content).unwrap();
        (file.name().to_owned(), content)
    };
    (0..zip::ZipArchive::new(Cursor::new(bytes)).unwrap().len()).map(each).collect()
}

fn zipped(members: &[(String, Vec<u8>)]) -> Vec<u8> {
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let plain = zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    for (name, content) in members {
        zip.start_file(name.as_str(), plain).unwrap();
        zip.write_all(content).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

/// Everything that can be read of bytes; the messages of what cannot.
fn read_all(bytes: &[u8]) -> Vec<String> {
    let mut faults = Vec::new();
    match TensorFile::from_bytes("a.ckpt", bytes) {
        Err(e) => faults.push(e.to_string()),
        Ok(mut file) => {
            let names: Vec<String> = file.shapes().map(|(name, _)| name.to_owned()).collect();
            faults.extend(names.iter().filter_map(|name| file.read(name).err()).map(|e| e.to_string()));
            file.step();
            file.setting("levels");
        }
    }
    faults
}

/// As the fuzzer has it: sentences with the file's name, and memory that the file may ask for.
fn survives(what: &str, bytes: &[u8]) -> Vec<String> {
    let (faults, peak) = peak::of(|| read_all(bytes));
    assert!(peak.is_lean("a.ckpt", bytes.len()), "{what}: {peak:?} for a file of {}", bytes.len());
    for fault in &faults {
        assert!(fault.starts_with("a.ckpt: ") && fault.len() < 1000, "{what}: {fault}");
    }
    faults
}

#[test]
fn cut_and_changed_checkpoints_end_in_sentences() {
    for end in (0..LIGHTNING.len()).step_by(37) {
        assert!(!survives(&format!("cut at {end}"), &LIGHTNING[..end]).is_empty());
    }
    let whole = members(LIGHTNING);
    let pickle = whole.iter().position(|(name, _)| name.ends_with("data.pkl")).unwrap();
    let (mut read, mut refused) = (0, 0);
    for at in 0..whole[pickle].1.len() {
        let bytes = [0x00, 0xff, b'(', b't', b'R', b'b', b'u', b'2', 0x90, 0x81];
        for byte in [bytes[at % 10], bytes[(at / 10 + 3) % 10]] {
            let mut changed = whole.clone();
            changed[pickle].1[at] = byte;
            match survives(&format!("byte {at} as {byte}"), &zipped(&changed)).is_empty() {
                true => read += 1,
                false => refused += 1,
            }
        }
    }
    assert!(read > 1000 && refused > 1000, "{read} {refused}");
}

/// A checkpoint whose pickle this is, with the storage `0` of eight bytes.
fn checkpoint(pickle: &[u8]) -> Vec<u8> {
    zipped(&[("x/data.pkl".into(), pickle.to_vec()), ("x/data/0".into(), vec![0; 8])])
}

/// `{"w": tensor}` with what follows the storage.
fn tensor(rest: &[u8]) -> Vec<u8> {
    let mut pickle = b"\x80\x02}X\x01\0\0\0wctorch._utils\n_rebuild_tensor_v2\n((X\x07\0\0\0storage".to_vec();
    pickle.extend(b"ctorch\nFloatStorage\nX\x01\0\0\x000X\x03\0\0\0cpuK\x02tQ");
    pickle.extend(rest);
    pickle.extend(b"\x89)tRs.");
    checkpoint(&pickle)
}

#[test]
fn tensors_beyond_their_storage_are_refused() {
    assert!(read_all(&tensor(b"K\0K\x02\x85K\x01\x85")).is_empty());
    for (what, rest) in [
        ("offset", &b"K\x03K\x01\x85K\x01\x85"[..]),
        ("shape", b"K\0K\x03\x85K\x01\x85"),
        ("shape and offset", b"K\x01K\x02\x85K\x01\x85"),
        ("strides", b"K\0K\x02\x85K\x02\x85"),
        ("repeated", b"K\0J\xff\xff\xff\x7f\x85K\0\x85"),
        ("fewer strides", b"K\0K\x02\x85)"),
        ("a negative length", b"K\0J\xff\xff\xff\xff\x85K\x01\x85"),
    ] {
        let faults = survives(what, &tensor(rest));
        assert_eq!(faults.len(), 1, "{what}: {faults:?}");
    }
}

#[test]
fn a_table_is_found_by_its_tensors_and_what_is_not_read_in_it_is_named() {
    // {"epoch": 3, "optimizer": {"s": w}, "ema": {"net": {"a": w, "b": w, "c": object}}}
    let text = |s: &str| [b"X", &(s.len() as u32).to_le_bytes()[..], s.as_bytes()].concat();
    let w = [
        &b"ctorch._utils\n_rebuild_tensor_v2\n(("[..],
        &text("storage"),
        b"ctorch\nFloatStorage\n",
        &text("0"),
        &text("cpu"),
        b"K\x02tQK\0K\x02\x85K\x01\x85\x89)tR",
    ]
    .concat();
    let named = |name: &str, value: &[u8]| [text(name), value.to_vec()].concat();
    let table = |all: &[Vec<u8>]| [&b"}("[..], &all.concat(), b"u"].concat();
    let object = named("c", b"ctorch._utils\n_rebuild_qtensor\n)R");
    let net = table(&[named("a", &w), named("b", &w), object]);
    let all = [
        named("epoch", b"K\x03"),
        named("optimizer", &table(&[named("s", &w)])),
        named("ema", &table(&[named("net", &net)])),
    ];
    let bytes = checkpoint(&[b"\x80\x02", &table(&all)[..], b"."].concat());
    let file = open(&bytes).unwrap();
    assert_eq!(file.shapes().map(|(name, _)| name).collect::<Vec<_>>(), ["a", "b"]);
    assert_eq!(file.unread(), ["c"]);
}

#[test]
fn a_dictionary_that_holds_itself_often_is_looked_at_once() {
    let text = |s: &str| [b"X", &(s.len() as u32).to_le_bytes()[..], s.as_bytes()].concat();
    // {"a": itself, "a": itself, ...}
    let own = [&b"}q\0("[..], &text("a"), b"q\x01h\0", &b"h\x01h\0".repeat(9_999), b"u"].concat();
    let alone = checkpoint(&[b"\x80\x02", &own[..], b"."].concat());
    assert!(survives("alone", &alone)[0].contains("no table of named tensors"));
    // Beside a table, as the settings.
    let w = &tensor(b"K\0K\x02\x85K\x01\x85");
    let (_, w) = members(w).into_iter().find(|(name, _)| name.ends_with("data.pkl")).unwrap();
    let pairs = &w[3..w.len() - 2];
    let pickle = [&b"\x80\x02}("[..], pairs, &text("hyper_parameters"), &own, b"u."].concat();
    let both = checkpoint(&pickle);
    assert_eq!(open(&both).unwrap().shapes().count(), 1);
    assert!(survives("settings", &both).is_empty());
}

#[test]
fn files_that_are_no_checkpoints_say_what_to_do() {
    let refusal = |bytes: &[u8]| read_all(bytes).remove(0);
    assert!(refusal(b"").contains("torch before 1.6"));
    assert!(refusal(b"\x80\x02\x8a\nl\xfc\x9cF").contains("save it again"));
    assert!(refusal(&LIGHTNING[..5000]).contains("cut short"));
    assert!(refusal(&zipped(&[("a.npy".into(), vec![])])).contains("`a.npy`"));
    // A whole module, pickled: nothing of it is made.
    let module = checkpoint(b"\x80\x02cmodels\nNet\n)\x81}X\x01\0\0\0wK\x01sb.");
    assert!(refusal(&module).contains("state_dict"), "{}", refusal(&module));
    // What would be run elsewhere is read over.
    let bomb = checkpoint(b"\x80\x02}X\x01\0\0\0xcposix\nsystem\nX\x04\0\0\0true\x85Rs.");
    assert!(refusal(&bomb).contains("no table of named tensors"));
    let missing = tensor(b"K\0K\x02\x85K\x01\x85");
    let mut all = members(&missing);
    all.retain(|(name, _)| name.ends_with("data.pkl"));
    assert!(refusal(&zipped(&all)).contains("`x/data/0` is missing"));
}
