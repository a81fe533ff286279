//! A side of a comparison: a process that answers requests, a JSON object a line.
//!
//! `{"do": NAME, ...}` is answered by `{"ok": ...}` or `{"error": sentence}`; Python's half of this is
//! `python/serve.py`.

use std::io::{BufRead, BufReader, Write};
use std::os::unix::fs::FileExt;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::Duration;

use anyhow::{Context, Result, anyhow, bail};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

/// Longer than any request takes.
pub const PATIENCE: Duration = Duration::from_secs(3600);

/// The process of a side. It ends with this.
pub struct Side {
    name: String,
    child: Child,
    input: Option<ChildStdin>,
    replies: Receiver<String>,
    errors: std::fs::File,
}

#[derive(Deserialize)]
#[serde(rename_all = "snake_case")]
enum Reply {
    Ok(Value),
    Error(String),
}

impl Side {
    /// riglab's side of a case: this program again. Whatever it computes takes no more than so many threads at a time.
    pub fn ours(case: &str, threads: usize) -> Result<Self> {
        let mut command = Command::new(std::env::current_exe()?);
        command.args(["--side", case, "--threads", &threads.to_string()]);
        Self::start("riglab", command)
    }

    /// Starts a command that answers requests.
    pub fn start(name: &str, mut command: Command) -> Result<Self> {
        // What it prints is shown only when it fails.
        let errors = tempfile::tempfile()?;
        let shown = command.get_program().to_string_lossy().into_owned();
        if std::env::var_os("OMP_WAIT_POLICY").is_none() && std::env::var_os("GOMP_SPINCOUNT").is_none() {
            // As `riglab_torch::wait_patiently` does for riglab; for both, since what spinning threads
            // cost on a busy machine is not what is compared.
            command.env("GOMP_SPINCOUNT", "1000");
        }
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(errors.try_clone()?);
        let mut child = command.spawn().with_context(|| format!("cannot start `{shown}`"))?;
        let (input, output) = (child.stdin.take(), child.stdout.take().context("its output is a pipe")?);
        let (send, replies) = channel();
        std::thread::spawn(move || {
            for line in BufReader::new(output).lines().map_while(Result::ok) {
                if send.send(line).is_err() {
                    break;
                }
            }
        });
        Ok(Self { name: name.into(), child, input, replies, errors })
    }

    /// Asks, and waits for the answer.
    pub fn ask<T: DeserializeOwned>(&mut self, request: &Value) -> Result<T> {
        self.ask_within(PATIENCE, request)
    }

    /// As [`Self::ask`]; the process is given up when it takes longer.
    pub fn ask_within<T: DeserializeOwned>(&mut self, limit: Duration, request: &Value) -> Result<T> {
        self.send(request)?;
        self.receive(limit)
    }

    /// Asks without waiting; [`Self::answer`] gets the answer.
    pub fn send(&mut self, request: &Value) -> Result<()> {
        let input = self.input.as_mut().context("its input is a pipe")?;
        if writeln!(input, "{request}").and_then(|()| input.flush()).is_err() {
            return Err(self.died());
        }
        Ok(())
    }

    /// The answer to what was sent.
    pub fn answer<T: DeserializeOwned>(&mut self) -> Result<T> {
        self.receive(PATIENCE)
    }

    fn receive<T: DeserializeOwned>(&mut self, limit: Duration) -> Result<T> {
        match self.replies.recv_timeout(limit) {
            Ok(line) => match serde_json::from_str(&line).with_context(|| format!("{} answered {line}", self.name))? {
                Reply::Ok(value) => Ok(serde_json::from_value(value)?),
                Reply::Error(e) => Err(anyhow!("{}: {e}{}", self.name, self.last_words())),
            },
            Err(RecvTimeoutError::Timeout) => bail!("{} took more than {} s", self.name, limit.as_secs()),
            Err(RecvTimeoutError::Disconnected) => Err(self.died()),
        }
    }

    fn died(&mut self) -> anyhow::Error {
        let status = self.child.wait().map_or("unknown".into(), |s| s.to_string());
        anyhow!("{} ended early ({status}){}", self.name, self.last_words())
    }

    /// The end of what it printed.
    fn last_words(&self) -> String {
        // Read by place: the process writes at the position that both share.
        let size = self.errors.metadata().map_or(0, |m| m.len());
        let from = size.saturating_sub(4096);
        let mut text = vec![0; (size - from) as usize];
        let read = self.errors.read_at(&mut text, from).unwrap_or(0);
        let text = String::from_utf8_lossy(&text[..read]);
        let lines: Vec<&str> = text.lines().collect();
        lines[lines.len().saturating_sub(12)..].iter().map(|l| format!("\n    {l}")).collect()
    }
}

impl Drop for Side {
    fn drop(&mut self) {
        // It leaves when its input ends; one that does not is busy with what nobody waits for.
        self.input = None;
        for _ in 0..50 {
            if matches!(self.child.try_wait(), Ok(Some(_))) {
                return;
            }
            std::thread::sleep(Duration::from_millis(100));
        }
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Answers requests on standard input until it ends.
pub fn serve<Q: DeserializeOwned>(mut answer: impl FnMut(Q) -> Result<Value>) -> Result<()> {
    for line in std::io::stdin().lock().lines() {
        let reply = match serde_json::from_str(&line?).map_err(Into::into).and_then(&mut answer) {
            Ok(value) => json!({"ok": value}),
            Err(e) => json!({"error": format!("{e:#}")}),
        };
        let mut out = std::io::stdout().lock();
        writeln!(out, "{reply}")?;
        out.flush()?;
    }
    Ok(())
}

/// The most memory this process has held, in MB.
pub fn peak_memory_mb() -> f64 {
    let text = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = text.lines().find_map(|l| l.strip_prefix("VmHWM:"));
    // The kernel's "kB" are 1024 bytes.
    line.and_then(|l| l.trim().split(' ').next()?.parse::<f64>().ok()).map_or(f64::NAN, |kib| kib * 1.024 / 1e3)
}

/// Lets the peak begin anew, where the system can.
pub fn forget_peak() {
    let _ = std::fs::write("/proc/self/clear_refs", "5");
}

/// Processor time of all threads of this process.
pub fn cpu_seconds() -> f64 {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: the clock exists on Linux, and the struct is filled.
    unsafe { libc::clock_gettime(libc::CLOCK_PROCESS_CPUTIME_ID, &mut time) };
    time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shell(script: &str) -> Side {
        let mut command = Command::new("sh");
        command.args(["-c", script]);
        Side::start("it", command).unwrap()
    }

    #[test]
    fn both_sides_count_memory_in_the_same_unit() {
        let script = "import serve; a = serve.peak_memory_mb(); f = open('/proc/self/status'); \
                      print(a, next(int(l.split()[1]) for l in f if l.startswith('VmHWM:')) * 1024 / 1e6)";
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/python");
        let mut python = Command::new("python3");
        let python = python.args(["-B", "-c", script]).env("PYTHONPATH", folder);
        let Ok(out) = python.output() else { return println!("skipped: no python3") };
        let said = String::from_utf8_lossy(&out.stdout);
        let numbers: Vec<f64> = said.split_whitespace().filter_map(|word| word.parse().ok()).collect();
        let [theirs, wanted] = numbers[..] else { panic!("{said}{}", String::from_utf8_lossy(&out.stderr)) };
        // It may have grown a little in between.
        assert!((theirs / wanted - 1.0).abs() < 0.01, "{said}");
    }

    #[test]
    fn answers_and_errors_arrive() {
        let mut side = shell("read a; echo '{\"ok\": 7}'; read b; echo why >&2; echo '{\"error\": \"no\"}'");
        assert_eq!(side.ask::<u32>(&json!({"do": "x"})).unwrap(), 7);
        let e = side.ask::<u32>(&json!({"do": "y"})).unwrap_err().to_string();
        assert_eq!(e, "it: no\n    why");
    }

    #[test]
    fn a_side_that_dies_or_hangs_is_told() {
        let died = shell("echo gone >&2; exit 3").ask::<u32>(&json!({})).unwrap_err().to_string();
        assert!(died.contains("ended early (exit status: 3)") && died.contains("gone"), "{died}");
        let mut hangs = shell("read a; exec sleep 60");
        let late = hangs.ask_within::<u32>(Duration::from_millis(50), &json!({})).unwrap_err().to_string();
        assert!(late.contains("took more than"), "{late}");
        hangs.child.kill().unwrap();
    }
}
