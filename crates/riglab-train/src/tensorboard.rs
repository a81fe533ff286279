//! TensorBoard's event files.
//!
//! The records and messages are those of `tensorboard-rs` and its protos; its writer is not used,
//! since it panics where the disk refuses and lacks text, histograms of data and hyperparameters.

use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter};
use std::path::Path;
use std::time::SystemTime;

use protobuf::{Message, RepeatedField};
use tensorboard_proto::api::{Experiment, HParamInfo, MetricInfo, MetricName, Status};
use tensorboard_proto::event::{Event, SessionLog, SessionLog_SessionStatus};
use tensorboard_proto::plugin_hparams::{HParamsPluginData, SessionEndInfo, SessionStartInfo};
use tensorboard_proto::summary::{
    HistogramProto, Summary, Summary_Image, Summary_Value, SummaryMetadata, SummaryMetadata_PluginData,
};
use tensorboard_proto::tensor::TensorProto;
use tensorboard_proto::tensor_shape::{TensorShapeProto, TensorShapeProto_Dim};
use tensorboard_proto::types::DataType;
use tensorboard_rs::record_writer::RecordWriter;

/// One event file.
pub struct TensorBoard {
    writer: RecordWriter<BufWriter<File>>,
}

impl TensorBoard {
    /// Begins a file in `dir` for a run that has done `step` steps. Points after that step in older
    /// files of the folder are dropped by TensorBoard; all of them where the run begins again.
    ///
    /// # Errors
    /// The file system's.
    pub fn create(dir: &Path, step: u64) -> io::Result<Self> {
        fs::create_dir_all(dir)?;
        let others = fs::read_dir(dir)?.flatten().any(|file| file.file_name().to_string_lossy().contains("tfevents"));
        let seconds = now() as u64;
        // A process id keeps runs of one second apart, a count the files of one process.
        let name = |n: usize| format!("events.out.tfevents.{seconds:010}.riglab.{}.{n}", std::process::id());
        let mut n = 0;
        let file = loop {
            match OpenOptions::new().write(true).create_new(true).open(dir.join(name(n))) {
                Err(e) if e.kind() == io::ErrorKind::AlreadyExists => n += 1,
                other => break other?,
            }
        };
        let mut board = Self { writer: RecordWriter::new(BufWriter::new(file)) };
        let mut version = Event::new();
        version.set_file_version("brain.Event:2".into());
        board.event(version, 0)?;
        // A run that was killed before its first checkpoint begins again, and says its settings again, too.
        let again = if step > 0 { Some(step + 1) } else { others.then_some(0) };
        if let Some(from) = again {
            let mut log = SessionLog::new();
            log.set_status(SessionLog_SessionStatus::START);
            let mut restart = Event::new();
            restart.set_session_log(log);
            board.event(restart, from)?;
        }
        board.flush()?;
        Ok(board)
    }

    /// A point of a curve.
    ///
    /// # Errors
    /// The file system's.
    pub fn scalar(&mut self, tag: &str, value: f64, step: u64) -> io::Result<()> {
        let mut v = named(tag);
        v.set_simple_value(value as f32);
        self.value(v, step)
    }

    /// How values are spread. Non-finite ones are left out.
    ///
    /// # Errors
    /// The file system's.
    pub fn histogram(&mut self, tag: &str, values: &[f32], step: u64) -> io::Result<()> {
        let mut v = named(tag);
        v.set_histo(histogram(values));
        self.value(v, step)
    }

    /// A picture, as the bytes of a PNG file.
    ///
    /// # Errors
    /// The file system's.
    pub fn picture(&mut self, tag: &str, width: u32, height: u32, png: &[u8], step: u64) -> io::Result<()> {
        let mut picture = Summary_Image::new();
        picture.set_width(width as i32);
        picture.set_height(height as i32);
        picture.set_colorspace(3);
        picture.set_encoded_image_string(png.to_vec());
        let mut v = named(tag);
        v.set_image(picture);
        self.value(v, step)
    }

    /// A text in Markdown.
    ///
    /// # Errors
    /// The file system's.
    pub fn text(&mut self, tag: &str, markdown: &str, step: u64) -> io::Result<()> {
        let mut dim = TensorShapeProto_Dim::new();
        dim.set_size(1);
        let mut shape = TensorShapeProto::new();
        shape.set_dim(RepeatedField::from_vec(vec![dim]));
        let mut tensor = TensorProto::new();
        tensor.set_dtype(DataType::DT_STRING);
        tensor.set_tensor_shape(shape);
        tensor.set_string_val(RepeatedField::from_vec(vec![markdown.as_bytes().to_vec()]));
        let mut v = named(&format!("{tag}/text_summary"));
        v.set_metadata(plugin("text", Vec::new()));
        v.set_tensor(tensor);
        self.value(v, step)
    }

    /// The run's settings, for the page that compares runs; `metrics` are tags of curves.
    ///
    /// # Errors
    /// The file system's.
    pub fn hparams(&mut self, settings: &BTreeMap<String, String>, metrics: &[&str]) -> io::Result<()> {
        let mut experiment = Experiment::new();
        let infos = settings.keys().map(|k| {
            let mut info = HParamInfo::new();
            info.set_name(k.clone());
            info
        });
        experiment.set_hparam_infos(infos.collect());
        let infos = metrics.iter().map(|m| {
            let mut name = MetricName::new();
            name.set_tag((*m).to_string());
            let mut info = MetricInfo::new();
            info.set_name(name);
            info
        });
        experiment.set_metric_infos(infos.collect());
        let mut start = SessionStartInfo::new();
        start.set_start_time_secs(now());
        start.set_hparams(
            settings
                .iter()
                .map(|(k, v)| {
                    let mut value = protobuf::well_known_types::Value::new();
                    match v.parse::<f64>() {
                        Ok(x) => value.set_number_value(x),
                        Err(_) => value.set_string_value(v.clone()),
                    }
                    (k.clone(), value)
                })
                .collect(),
        );
        let mut end = SessionEndInfo::new();
        end.set_status(Status::STATUS_SUCCESS);
        end.set_end_time_secs(now());
        let mut data = [HParamsPluginData::new(), HParamsPluginData::new(), HParamsPluginData::new()];
        data[0].set_experiment(experiment);
        data[1].set_session_start_info(start);
        data[2].set_session_end_info(end);
        for (data, name) in data.iter().zip(["experiment", "session_start_info", "session_end_info"]) {
            let mut tensor = TensorProto::new();
            tensor.set_dtype(DataType::DT_FLOAT);
            tensor.set_tensor_shape(TensorShapeProto::new());
            tensor.set_float_val(vec![0.0]);
            let mut v = named(&format!("_hparams_/{name}"));
            v.set_metadata(plugin("hparams", bytes(data)?));
            v.set_tensor(tensor);
            self.value(v, 0)?;
        }
        Ok(())
    }

    /// Hands everything to the system.
    ///
    /// # Errors
    /// The file system's.
    pub fn flush(&mut self) -> io::Result<()> {
        self.writer.flush()
    }

    fn value(&mut self, value: Summary_Value, step: u64) -> io::Result<()> {
        let mut summary = Summary::new();
        summary.set_value(RepeatedField::from_vec(vec![value]));
        let mut event = Event::new();
        event.set_summary(summary);
        self.event(event, step)
    }

    fn event(&mut self, mut event: Event, step: u64) -> io::Result<()> {
        event.set_wall_time(now());
        event.set_step(step as i64);
        self.writer.write(&bytes(&event)?)
    }
}

fn now() -> f64 {
    SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).map_or(0.0, |d| d.as_secs_f64())
}

fn bytes(message: &impl Message) -> io::Result<Vec<u8>> {
    message.write_to_bytes().map_err(io::Error::other)
}

fn named(tag: &str) -> Summary_Value {
    let mut v = Summary_Value::new();
    v.set_tag(tag.into());
    v
}

fn plugin(name: &str, content: Vec<u8>) -> SummaryMetadata {
    let mut data = SummaryMetadata_PluginData::new();
    data.set_plugin_name(name.into());
    data.set_content(content);
    let mut meta = SummaryMetadata::new();
    meta.set_plugin_data(data);
    meta
}

/// Thirty equal buckets over the range of the finite values.
fn histogram(values: &[f32]) -> HistogramProto {
    const BUCKETS: usize = 30;
    let finite: Vec<f64> = values.iter().filter(|v| v.is_finite()).map(|&v| f64::from(v)).collect();
    let (low, high) = finite.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), &v| (l.min(v), h.max(v)));
    let (low, high) = if finite.is_empty() { (0.0, 0.0) } else { (low, high) };
    let width = ((high - low) / BUCKETS as f64).max(f64::MIN_POSITIVE);
    let mut counts = vec![0.0; BUCKETS];
    for v in &finite {
        counts[(((v - low) / width) as usize).min(BUCKETS - 1)] += 1.0;
    }
    let mut h = HistogramProto::new();
    h.set_min(low);
    h.set_max(high);
    h.set_num(finite.len() as f64);
    h.set_sum(finite.iter().sum());
    h.set_sum_squares(finite.iter().map(|v| v * v).sum());
    h.set_bucket_limit((1..=BUCKETS).map(|i| low + width * i as f64).collect());
    h.set_bucket(counts);
    h
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The events of a file: a record is its length in 8 bytes, a checksum of 4, the message, and one of 4 again.
    fn events(path: &Path) -> Vec<Event> {
        let bytes = fs::read(path).unwrap();
        let (mut rest, mut events) = (&bytes[..], Vec::new());
        while let Some((length, more)) = rest.split_first_chunk::<8>() {
            let length = u64::from_le_bytes(*length) as usize;
            events.push(Event::parse_from_bytes(&more[4..4 + length]).unwrap());
            rest = &more[length + 8..];
        }
        events
    }

    #[test]
    fn points_of_older_files_are_dropped_from_where_a_run_goes_on() {
        let dir = tempfile::tempdir().unwrap();
        let mut seen: Vec<std::path::PathBuf> = Vec::new();
        // The first; one that was killed before its first checkpoint; one that goes on after step 7.
        let from = [0, 0, 7].map(|step| {
            let mut board = TensorBoard::create(dir.path(), step).unwrap();
            board.scalar("train/loss", 0.5, step + 1).unwrap();
            board.flush().unwrap();
            let files = fs::read_dir(dir.path()).unwrap().map(|file| file.unwrap().path());
            let new: Vec<_> = files.filter(|path| !seen.contains(path)).collect();
            seen.extend(new.clone());
            let starts = events(&new[0]).into_iter().filter(Event::has_session_log);
            starts.map(|e| e.get_step()).collect::<Vec<_>>()
        });
        assert_eq!(from, [vec![], vec![0], vec![8]]);
    }
}
