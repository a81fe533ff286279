//! The forms in which a command writes tables, and the systems that it writes of.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail};
use riglab_files::make_folder_of;
use riglab_report::{Block, Page, PageKind, Table};

use super::earlier::{Written, keep_others};
use super::file_instead_of_output;

/// Options that say in which form, and where to.
#[derive(clap::Args)]
pub struct Forms {
    /// Everything as JSON.
    #[arg(long, group = "form")]
    pub json: bool,
    /// Comma-separated values: every asset.
    #[arg(long, group = "form")]
    pub csv: bool,
    /// Tables in Markdown.
    #[arg(long, group = "form")]
    markdown: bool,
    /// Tables in LaTeX, with booktabs; tables wider than a page with graphicx, too.
    #[arg(long, group = "form")]
    latex: bool,
    /// A page.
    #[arg(long, group = "form")]
    html: bool,
    /// Write to a file instead of standard output: FILE.txt, .html, .md, .tex, .csv or .json is of that form, and without an
    /// ending, where no option says the form, all but the first are written.
    #[arg(long, short, value_name = "FILE", value_parser = file_instead_of_output())]
    out: Option<PathBuf>,
}

/// What tables are written as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    Text,
    Html,
    Markdown,
    Latex,
    Csv,
    Json,
}

impl Form {
    /// By the ending of their files.
    const ALL: [(&str, Self); 6] = [
        ("txt", Self::Text),
        ("html", Self::Html),
        ("md", Self::Markdown),
        ("tex", Self::Latex),
        ("csv", Self::Csv),
        ("json", Self::Json),
    ];

    /// Tables, in a form that is for readers; CSV and JSON are the command's own.
    pub fn of(self, tables: Vec<Table>, kind: PageKind, title: &str, subtitle: &str) -> Result<String> {
        let to = match self {
            Self::Html => {
                let blocks = tables.into_iter().map(Block::Table).collect();
                return Ok(Page { kind, title: title.into(), subtitle: subtitle.into(), blocks }.to_html()?);
            }
            Self::Markdown => Table::to_markdown,
            Self::Latex => Table::to_latex,
            _ => Table::to_text,
        };
        let needs = if self == Self::Latex {
            "% Needs \\usepackage{booktabs}, and textcomp where LaTeX is older than 2020.\n\n"
        } else {
            ""
        };
        Ok(needs.to_owned() + &tables.iter().map(to).collect::<Vec<_>>().join("\n"))
    }
}

impl Forms {
    /// The files to write, each with its form; none where all goes to standard output.
    ///
    /// # Errors
    /// When one is there that is none of those `written` before, or has the ending of another form, or none can be written
    /// there.
    pub fn files(&self, written: Written) -> Result<Vec<(PathBuf, Form)>> {
        let files = self.out.as_deref().map_or(Ok(Vec::new()), |out| files(out, self.asked()))?;
        files.iter().try_for_each(|(file, _)| keep_others(file, written))?;
        // Before the work, which may take hours, not after it.
        let folder = files.first().and_then(|(file, _)| file.parent());
        let remedy = "give --out a place where you may write, or make this one so";
        folder
            .map_or(Ok(()), riglab_files::may_write)
            .map_err(|e| anyhow!("nothing can be written into {e}; {remedy}"))?;
        Ok(files)
    }

    /// Writes them, or what was asked for to standard output.
    ///
    /// # Errors
    /// When there is no text, or a file cannot be written.
    pub fn write(&self, files: &[(PathBuf, Form)], text: impl Fn(Form) -> Result<String>) -> Result<()> {
        for (path, form) in files {
            let text = text(*form)?;
            let written = make_folder_of(path).and_then(|()| riglab_files::write(path, text.as_bytes()));
            written.with_context(|| format!("{} cannot be written", path.display()))?;
            say!("{}", path.display());
        }
        if files.is_empty() {
            let text = text(self.asked().unwrap_or(Form::Text))?;
            let content = text.trim_end();
            // The last line as the others: those of CSV end in two signs.
            let end = if text[content.len()..].starts_with("\r\n") { "\r\n" } else { "\n" };
            crate::say::whole(format_args!("{content}{end}"));
        }
        Ok(())
    }

    /// The form that an option asks for.
    fn asked(&self) -> Option<Form> {
        let asked = [
            (self.html, Form::Html),
            (self.markdown, Form::Markdown),
            (self.latex, Form::Latex),
            (self.csv, Form::Csv),
            (self.json, Form::Json),
        ];
        asked.into_iter().find(|(asked, _)| *asked).map(|(_, form)| form)
    }
}

/// The files to write, each with its form: as the option says, else as the ending does; all forms without either, as
/// `riglab report` has it.
fn files(out: &Path, asked: Option<Form>) -> Result<Vec<(PathBuf, Form)>> {
    let ending = out.extension().map(|e| e.to_string_lossy().into_owned());
    let told = ending.as_ref().and_then(|e| Form::ALL.iter().find(|(own, _)| own == e)).map(|(_, form)| *form);
    match (asked, told, ending) {
        // A text may be of any form.
        (Some(asked), Some(told), _) if told != asked && told != Form::Text => {
            let (fits, _) = Form::ALL.iter().find(|(_, form)| *form == asked).unwrap_or(&Form::ALL[0]);
            bail!(
                "{} does not end as the form does that an option asks for: leave the option out, or give a name that ends in \
                 .{fits}",
                out.display()
            )
        }
        (Some(asked), ..) => Ok(vec![(out.into(), asked)]),
        (None, Some(told), _) => Ok(vec![(out.into(), told)]),
        (None, None, Some(e)) => {
            let there = Form::ALL.map(|(own, _)| own).join(", .");
            bail!("{}: no form has the ending .{e}; there are .{there}", out.display())
        }
        (None, None, None) => {
            Ok(Form::ALL.iter().skip(1).map(|(ending, form)| (out.with_extension(ending), *form)).collect())
        }
    }
}

/// Systems and their folders, of arguments `[NAME=]DIR`.
///
/// # Errors
/// When two have one name.
pub fn systems(texts: &[String]) -> Result<Vec<(String, PathBuf)>> {
    let mut systems: Vec<(String, PathBuf)> = Vec::new();
    for (name, folder) in texts.iter().map(|text| named(text)) {
        if systems.iter().any(|(taken, _)| *taken == name) {
            bail!("two systems are called `{name}`; name them: NAME=DIR");
        }
        systems.push((name, folder));
    }
    Ok(systems)
}

/// The name of a system and its folder; without a name, that of the folder.
fn named(text: &str) -> (String, PathBuf) {
    match text.split_once('=') {
        Some((name, folder)) if !name.is_empty() && !Path::new(text).exists() => (name.into(), folder.into()),
        _ => {
            let path = PathBuf::from(text);
            let name = path.canonicalize().ok().and_then(|p| Some(p.file_name()?.to_string_lossy().into_owned()));
            (name.unwrap_or_else(|| text.to_owned()), path)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_option_or_an_ending_names_the_form_and_neither_takes_all() {
        let of = |out: &str, asked| files(Path::new(out), asked);
        let one = |out: &str, form| vec![(PathBuf::from(out), form)];
        assert_eq!(of("a/b.md", None).unwrap(), one("a/b.md", Form::Markdown));
        assert_eq!(of("b.txt", None).unwrap(), one("b.txt", Form::Text));
        for out in ["b", "b.json", "b.txt", "b.v2"] {
            assert_eq!(of(out, Some(Form::Json)).unwrap(), one(out, Form::Json));
        }
        let all = of("a/b", None).unwrap();
        let names: Vec<_> = all.iter().map(|(file, _)| file.to_str().unwrap()).collect();
        assert_eq!(names, ["a/b.html", "a/b.md", "a/b.tex", "a/b.csv", "a/b.json"]);
        let said = of("b.html", Some(Form::Csv)).unwrap_err().to_string();
        assert!(said.contains("b.html does not end as the form does") && said.contains("ends in .csv"), "{said}");
        let said = of("b.pdf", None).unwrap_err().to_string();
        assert!(said.contains("no form has the ending .pdf; there are .txt, .html"), "{said}");
    }

    #[test]
    fn where_nothing_can_be_written_is_told_before_the_work() {
        #[derive(clap::Parser)]
        struct Line {
            #[command(flatten)]
            forms: Forms,
        }
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("notes");
        std::fs::write(&file, "mine").unwrap();
        let of = |out: PathBuf| {
            let line = ["compare", "-o", out.to_str().unwrap()];
            <Line as clap::Parser>::parse_from(line).forms.files(Written::Comparison)
        };
        assert_eq!(of(dir.path().join("new/scores.csv")).unwrap().len(), 1);
        let said = of(file.join("scores.csv")).unwrap_err().to_string();
        assert!(said.contains("nothing can be written into") && said.contains("give --out a place"), "{said}");
    }

    #[test]
    fn systems_have_names_of_their_own() {
        assert_eq!(named("a=b/c"), ("a".into(), "b/c".into()));
        assert_eq!(named("nowhere/x"), ("nowhere/x".into(), "nowhere/x".into()));
        let dir = tempfile::tempdir().unwrap();
        let odd = dir.path().join("k=1");
        std::fs::create_dir(&odd).unwrap();
        assert_eq!(named(odd.to_str().unwrap()), ("k=1".into(), odd));
        let of = |texts: [&str; 2]| systems(&texts.map(String::from)).map_err(|e| e.to_string());
        assert_eq!(of(["a=x", "b=x"]).unwrap().len(), 2);
        assert!(of(["a=x", "a=y"]).unwrap_err().contains("two systems are called `a`"));
    }
}
