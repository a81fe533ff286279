//! A Slurm cluster of this machine alone: a controller and two nodes, started by the test, ended with it.

use std::fs;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// A running cluster.
pub struct Cluster {
    folder: PathBuf,
    controller: Option<Child>,
    nodes: Vec<Child>,
}

impl Cluster {
    /// Starts one within a folder; `None`, with a line that says so, where Slurm is not installed.
    pub fn start(folder: &Path) -> Option<Self> {
        let plugins =
            ["/usr/lib/x86_64-linux-gnu/slurm-wlm", "/usr/lib/aarch64-linux-gnu/slurm-wlm", "/usr/lib64/slurm"];
        let has_plugin = plugins.iter().any(|dir| Path::new(dir).join("auth_none.so").is_file());
        if ["slurmctld", "slurmd", "sbatch"].iter().any(|p| program(p).is_none()) || !has_plugin {
            println!("skipped: no slurmctld/slurmd/munged here; apt-get install slurmctld slurmd munge");
            return None;
        }
        for name in ["state", "log", "spool/n1", "spool/n2"] {
            fs::create_dir_all(folder.join(name)).unwrap();
        }
        fs::write(folder.join("slurm.conf"), settings(folder)).unwrap();
        let mut cluster = Self { folder: folder.into(), controller: None, nodes: Vec::new() };
        cluster.start_controller();
        for node in ["n1", "n2"] {
            cluster.nodes.push(cluster.daemon("slurmd", &["-D", "-N", node], node));
        }
        cluster.until("two nodes are idle", || cluster.ask("sinfo", &["-h", "-N", "-o", "%T"]) == "idle\nidle");
        Some(cluster)
    }

    /// Makes a command know this cluster.
    pub fn known_to<'a>(&self, command: &'a mut Command) -> &'a mut Command {
        command.env("SLURM_CONF", self.folder.join("slurm.conf"))
    }

    /// What one of Slurm's programs answers, once it does.
    pub fn ask(&self, program: &str, args: &[&str]) -> String {
        let mut said = String::new();
        for _ in 0..20 {
            let out = self.known_to(Command::new(program).args(args)).output().unwrap();
            if out.status.success() {
                return String::from_utf8_lossy(&out.stdout).trim().to_owned();
            }
            said = String::from_utf8_lossy(&out.stderr).into_owned();
            std::thread::sleep(Duration::from_millis(500));
        }
        panic!("{program} {}: {said}\n{}", args.join(" "), self.log())
    }

    /// Whether one of Slurm's programs does what it is asked.
    pub fn does(&self, program: &str, args: &[&str]) -> bool {
        self.known_to(Command::new(program).args(args)).output().unwrap().status.success()
    }

    /// The same to some running task; it may just have ended, and then it does not.
    pub fn does_to_running(&self, program: &str, args: &[&str]) -> bool {
        let tasks = self.tasks("RUNNING");
        tasks.first().is_some_and(|task| self.does(program, &[args, &[task.as_str()]].concat()))
    }

    /// Tasks in the queue in this state, as `12_3`.
    pub fn tasks(&self, state: &str) -> Vec<String> {
        let said = self.ask("squeue", &["-h", "-r", "-t", state, "-o", "%i"]);
        said.lines().map(|l| l.trim().to_owned()).collect()
    }

    /// Waits for something, or fails with the controller's log.
    pub fn until(&self, what: &str, holds: impl Fn() -> bool) {
        let start = Instant::now();
        while !holds() {
            assert!(start.elapsed() < Duration::from_secs(180), "it never came about that {what}\n{}", self.log());
            std::thread::sleep(Duration::from_millis(100));
        }
    }

    /// Ends the controller, which saves its state, and starts it again.
    pub fn restart_controller(&mut self) {
        if let Some(mut child) = self.controller.take() {
            end(&mut child);
        }
        self.start_controller();
    }

    fn start_controller(&mut self) {
        self.controller = Some(self.daemon("slurmctld", &["-D"], "controller"));
        self.ask("scontrol", &["ping"]);
    }

    fn daemon(&self, name: &str, args: &[&str], log: &str) -> Child {
        let log = fs::OpenOptions::new().create(true).append(true).open(self.folder.join("log").join(log)).unwrap();
        let mut command = Command::new(program(name).unwrap());
        command.args(args).stdin(Stdio::null()).stdout(log.try_clone().unwrap()).stderr(log);
        self.known_to(&mut command).spawn().unwrap()
    }

    fn log(&self) -> String {
        fs::read_to_string(self.folder.join("log/controller")).unwrap_or_default()
    }
}

impl Drop for Cluster {
    fn drop(&mut self) {
        let _ = self.known_to(Command::new("scancel").args(["--user", &user()])).output();
        std::thread::sleep(Duration::from_millis(500));
        self.nodes.iter_mut().chain(&mut self.controller).for_each(end);
    }
}

fn end(child: &mut Child) {
    let _ = rustix::process::kill_process(rustix::process::Pid::from_child(child), rustix::process::Signal::TERM);
    let start = Instant::now();
    while child.try_wait().is_ok_and(|s| s.is_none()) {
        if start.elapsed() > Duration::from_secs(20) {
            let _ = child.kill();
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// A program, also where only root looks for it.
fn program(name: &str) -> Option<PathBuf> {
    let path = std::env::var_os("PATH").unwrap_or_default();
    let folders = std::env::split_paths(&path).chain(["/usr/sbin".into(), "/sbin".into()]);
    folders.map(|f| f.join(name)).find(|f| f.is_file())
}

fn user() -> String {
    let out = Command::new("id").arg("-un").output().unwrap();
    String::from_utf8_lossy(&out.stdout).trim().to_owned()
}

fn settings(folder: &Path) -> String {
    let host = fs::read_to_string("/proc/sys/kernel/hostname").unwrap();
    let host = host.trim().split('.').next().unwrap_or_default();
    // All at once, so that they differ.
    let free: Vec<TcpListener> = (0..3).map(|_| TcpListener::bind("127.0.0.1:0").unwrap()).collect();
    let port: Vec<u16> = free.iter().map(|l| l.local_addr().unwrap().port()).collect();
    let (user, at) = (user(), folder.display());
    // A requeued job waits for as long as credentials hold, two minutes by default. Arrays of four tasks at most.
    format!(
        "ClusterName=toy\nSlurmctldHost={host}(127.0.0.1)\nSlurmctldPort={}\nSlurmUser={user}\nSlurmdUser={user}\n\
         AuthType=auth/none\nCredType=cred/none\nAuthInfo=cred_expire=6\n\
         StateSaveLocation={at}/state\nSlurmdSpoolDir={at}/spool/%n\n\
         SlurmctldPidFile={at}/controller.pid\nSlurmdPidFile={at}/%n.pid\n\
         ProctrackType=proctrack/linuxproc\nTaskPlugin=task/none\nSwitchType=switch/none\nMpiDefault=none\n\
         SelectType=select/cons_tres\nSelectTypeParameters=CR_Core\nSlurmdParameters=config_overrides\n\
         ReturnToService=2\nKillWait=3\nMailProg=/bin/true\nMaxArraySize=4\n\
         NodeName=n1 NodeHostname={host} NodeAddr=127.0.0.1 Port={} CPUs=2\n\
         NodeName=n2 NodeHostname={host} NodeAddr=127.0.0.1 Port={} CPUs=2\n\
         PartitionName=main Nodes=n1,n2 Default=YES State=UP\n",
        port[0], port[1], port[2]
    )
}
