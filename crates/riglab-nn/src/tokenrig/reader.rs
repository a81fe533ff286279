//! Drawing sequences.

use tch::{Device, Kind, Tensor};

use super::place::Walk;
use super::{GEOMETRY, JointTold, TokenRig};
use crate::decoder::Cache;
use crate::generate::Decoder;
use crate::layers::affine;
use crate::params::Weights;

/// What the joints of a whole skeleton are told, each in order, from the row that it was drawn in and its drawn ids, the
/// prompt with them.
pub type Joints<'a> = dyn Fn(usize, &[u32]) -> Vec<JointTold> + Sync + 'a;

/// The model after the shapes and prompts of some rows, as what [`crate::generate`] draws from. Beams need
/// [`super::Head::Flat`]: they read tokens whole.
pub struct Reader<'a> {
    net: &'a TokenRig,
    weights: &'a Weights,
    cache: Cache,
    rows: Vec<Row>,
    joints: &'a Joints<'a>,
    skeleton_end: u32,
    tables: Option<Tables>,
}

#[derive(Clone, Default)]
struct Row {
    /// Which of the prompts it began with.
    of: usize,
    /// What was drawn, the prompt with it.
    drawn: Vec<u32>,
    joints: Vec<JointTold>,
    /// Along the skeleton's ids, until codes follow.
    walk: Option<Walk>,
    /// The joint whose code follows, and which of them.
    place: Option<(usize, usize)>,
    /// The first levels of a code in the drawing, and the vector that scores the next.
    levels: Vec<u32>,
    hidden: Vec<f32>,
}

/// The tables of [`Head::Levels`], to score levels without tensors.
struct Tables {
    /// Rows that score skeleton ids, the first level, an empty bone.
    first: Tensor,
    /// [Σ levels, d] each.
    score: Vec<f32>,
    chain: Vec<f32>,
    width: usize,
}

fn floats(t: &Tensor) -> Vec<f32> {
    Vec::<f32>::try_from(t.to_kind(Kind::Float).contiguous().view([-1])).unwrap_or_default()
}

impl<'a> Reader<'a> {
    /// Reads shapes [b, p, d] and then each row's prompt, all of the same length; gives what follows, with the
    /// scores of that. `tokens`: how many more will be read at most; `skeleton_end`: the id after which codes
    /// follow.
    pub fn start(
        net: &'a TokenRig,
        weights: &'a Weights,
        prefix: &Tensor,
        prompts: &[Vec<u32>],
        (tokens, skeleton_end): (usize, u32),
        joints: &'a Joints<'a>,
    ) -> Option<(Self, Vec<Vec<f32>>)> {
        let room = prompts.first().map_or(0, Vec::len) + tokens;
        let tables = net.levels.as_ref().map(|levels| {
            let table = weights[net.decoder.table()].narrow(0, 0, net.layout.skeleton());
            let (all, first) = (net.layout.offsets().1, net.layout.levels().first().copied().unwrap_or(0));
            let score = &weights[levels.score];
            Tables {
                first: Tensor::cat(&[&table, &score.narrow(0, 0, first), &score.narrow(0, all, 1)], 0),
                score: floats(score),
                chain: floats(&weights[levels.chain]),
                width: table.size()[1] as usize,
            }
        });
        // One shape may stand for all rows: it is read once.
        let mut cache = net.start(weights, prefix, room as i64 + 1);
        if prefix.size()[0] == 1 && prompts.len() > 1 {
            cache.select(&vec![0; prompts.len()]);
        }
        let rows = vec![Row { walk: Some(Walk::default()), ..Row::default() }; prompts.len()];
        let mut reader = Self { net, weights, cache, rows, joints, skeleton_end, tables };
        let ids: Vec<Vec<i64>> = prompts.iter().map(|p| net.layout.ids(p)).collect::<Option<_>>()?;
        for (row, prompt) in prompts.iter().enumerate() {
            let own = &mut reader.rows[row];
            own.of = row;
            own.drawn.clone_from(prompt);
        }
        let scores = reader.read(&ids);
        Some((reader, scores))
    }

    /// Reads as many ids in each row.
    fn read(&mut self, ids: &[Vec<i64>]) -> Vec<Vec<f32>> {
        let (rows, t) = (ids.len() as i64, ids.first().map_or(0, Vec::len) as i64);
        let told: Vec<f32> = if self.net.joints.is_some() {
            self.meet_joints(ids);
            ids.iter()
                .enumerate()
                .flat_map(|(row, ids)| ids.iter().flat_map(|&id| self.tell(row, id)).collect::<Vec<_>>())
                .collect()
        } else {
            Vec::new()
        };
        let flat: Vec<i64> = ids.iter().flatten().copied().collect();
        // A token of each row is little work.
        let x = if t == 1 {
            riglab_torch::alone(|| self.embedded(&flat, &told, rows, t))
        } else {
            self.embedded(&flat, &told, rows, t)
        };
        let hidden = self.net.decoder.read(self.weights, &x, &mut self.cache).select(1, t - 1);
        // Threads of libtorch that wait for more after an op would hold up those of the decoder.
        if t == 1 { riglab_torch::alone(|| self.scores(&hidden)) } else { self.scores(&hidden) }
    }

    fn device(&self) -> Device {
        self.weights.tensors().first().map_or(Device::Cpu, Tensor::device)
    }

    /// What the decoder reads of ids [rows, t], with what is told of what follows each and of where the joints are.
    fn embedded(&mut self, ids: &[i64], told: &[f32], rows: i64, t: i64) -> Tensor {
        let device = self.device();
        let mut x = self.net.embed(self.weights, &Tensor::from_slice(ids).view([rows, t]).to_device(device));
        if !told.is_empty() {
            let told = Tensor::from_slice(told).view([rows, t, -1]).to_device(device);
            if let Some(more) = self.net.tell(self.weights, &told) {
                x += more;
            }
        }
        if let Some(places) = &self.net.places {
            let each = self.rows.iter_mut().zip(ids.chunks(t as usize));
            let told: Vec<_> = each
                .flat_map(|(row, ids)| ids.iter().map(|&id| self.net.walked(&mut row.walk, id)).collect::<Vec<_>>())
                .collect();
            x += places.tell(self.weights, &told, &[rows, t]);
        }
        x
    }

    /// Has the joints of skeletons told that end with these ids: of all that end at once, as many at a time as there are
    /// threads.
    fn meet_joints(&mut self, ids: &[Vec<i64>]) {
        let (rows, joints, end) = (&self.rows, self.joints, self.skeleton_end);
        let skeleton = |row: usize| {
            let drawn = &rows[row].drawn;
            &drawn[..drawn.iter().position(|&id| id == end).map_or(0, |at| at + 1)]
        };
        let ending: Vec<usize> = (0..ids.len()).filter(|&row| ids[row].contains(&i64::from(end))).collect();
        // What was made for a skeleton may be known when another row has the same.
        let (mut first, mut again): (Vec<usize>, Vec<usize>) = Default::default();
        for row in ending {
            let known = first.iter().any(|&other| skeleton(other) == skeleton(row));
            if known { &mut again } else { &mut first }.push(row);
        }
        let make = |row: usize| (row, joints(rows[row].of, skeleton(row)));
        let hands = riglab_torch::threads_on(self.device()).min(first.len());
        let mut told: Vec<(usize, Vec<JointTold>)> = if hands > 1 {
            let (first, make) = (&first, &make);
            let deal = |hand: usize| move || first.iter().skip(hand).step_by(hands).map(|&row| make(row)).collect();
            let jobs: Vec<_> = (0..hands).map(deal).collect();
            riglab_torch::side_by_side::<Vec<_>, _>(jobs).into_iter().flatten().collect()
        } else {
            // Threads of libtorch would go on waiting for more beside the decoder's.
            riglab_torch::alone(|| first.into_iter().map(make).collect())
        };
        told.extend(again.into_iter().map(make));
        for (row, joints) in told {
            self.rows[row].joints = joints;
        }
    }

    /// Goes on after an id that is read, and says what is told of what follows it.
    fn tell(&mut self, row: usize, id: i64) -> Vec<f32> {
        let layout = &self.net.layout;
        let (slots, rule) = self.net.joints.as_ref().map_or((0, 0), |j| (j.slots as usize, j.rule));
        let own = &mut self.rows[row];
        if id == i64::from(self.skeleton_end) {
            own.place = Some((0, 0));
        } else if let Some((joint, slot)) = own.place {
            own.place = match id {
                id if id == layout.empty() => Some((joint + 1, 0)),
                id if id == layout.end() => None,
                _ if slot + 1 < slots => Some((joint, slot + 1)),
                _ => Some((joint + 1, 0)),
            };
        }
        let mut told = vec![0.0; GEOMETRY + 1 + rule];
        if let Some((joint, slot)) = own.place
            && let Some(at) = own.joints.get(joint)
        {
            at.at(slot, &mut told);
        }
        told
    }

    /// Scores of all drawn numbers after vectors [rows, d].
    fn scores(&mut self, hidden: &Tensor) -> Vec<Vec<f32>> {
        let width = self.net.layout.drawn();
        let Some(tables) = &self.tables else {
            let scores = self.net.logits(self.weights, hidden);
            let (own, flat) = (scores.size()[1] as usize, floats(&scores));
            // Beyond the released ids nothing is scored.
            let whole =
                |row: &[f32]| row.iter().copied().chain(std::iter::repeat_n(f32::NEG_INFINITY, width - own)).collect();
            return flat.chunks(own).map(whole).collect();
        };
        let scores = affine(hidden, &tables.first, None);
        let (own, flat) = (scores.size()[1] as usize, floats(&scores));
        let vectors = floats(hidden);
        for (row, vector) in self.rows.iter_mut().zip(vectors.chunks(tables.width)) {
            row.hidden = vector.to_vec();
            row.levels.clear();
        }
        let whole = |row: &[f32]| {
            let mut out = vec![f32::NEG_INFINITY; width];
            out[..own - 1].copy_from_slice(&row[..own - 1]);
            out[width - 1] = row[own - 1];
            // The end follows where nothing else may.
            out[width - 2] = 0.0;
            out
        };
        flat.chunks(own).map(whole).collect()
    }
}

impl Decoder for Reader<'_> {
    fn next(&mut self, ids: &[u32]) -> Vec<Vec<f32>> {
        let mut read = Vec::with_capacity(ids.len());
        for (row, &id) in self.rows.iter_mut().zip(ids) {
            let drawn: Vec<u32> = row.levels.drain(..).chain([id]).collect();
            row.drawn.extend(&drawn);
            // What the grammar lets through is whole.
            read.push(self.net.layout.ids(&drawn).unwrap_or_else(|| vec![i64::from(self.skeleton_end)]));
        }
        self.read(&read)
    }

    fn select(&mut self, rows: &[usize]) {
        self.cache.select(&rows.iter().map(|&r| r as i64).collect::<Vec<_>>());
        self.rows = rows.iter().map(|&r| self.rows[r].clone()).collect();
    }

    fn within(&mut self, row: usize, id: u32) -> Option<Vec<f32>> {
        let tables = self.tables.as_ref()?;
        let ranges = self.net.layout.ranges();
        let own = &mut self.rows[row];
        let level = own.levels.len();
        // A level, and not the last one.
        let next = ranges.get(level + 1)?;
        if !ranges[level].contains(&id) {
            return None;
        }
        own.levels.push(id);
        let (d, at) = (tables.width, (id - ranges[0].start) as usize);
        for (h, more) in own.hidden.iter_mut().zip(&tables.chain[at * d..(at + 1) * d]) {
            *h += more;
        }
        let mut out = vec![f32::NEG_INFINITY; self.net.layout.drawn()];
        for number in next.clone() {
            let at = (number - ranges[0].start) as usize;
            let score = &tables.score[at * d..(at + 1) * d];
            out[number as usize] = own.hidden.iter().zip(score).map(|(h, s)| h * s).sum();
        }
        Some(out)
    }
}
