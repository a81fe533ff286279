//! What the page asks for.

use riglab_curate::decisions::{Decision, Verdict};
use riglab_curate::{Category, CurateError};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::Review;
use crate::deck::Card;
use crate::guard::{Token, admit};
use crate::http::{Answer, Request};
use crate::pictures::Kind;

/// The page, compiled in: nothing is read from a folder, so no path can lead out of it.
const PAGE: [(&str, &str, &str); 8] = [
    ("", "text/html; charset=utf-8", include_str!("../page/index.html")),
    ("style.css", "text/css; charset=utf-8", include_str!("../page/style.css")),
    ("icon.svg", "image/svg+xml", include_str!("../page/icon.svg")),
    ("review.js", SCRIPT, include_str!("../page/review.js")),
    ("server.js", SCRIPT, include_str!("../page/server.js")),
    ("model.js", SCRIPT, include_str!("../page/model.js")),
    ("sheet.js", SCRIPT, include_str!("../page/sheet.js")),
    ("detail.js", SCRIPT, include_str!("../page/detail.js")),
];
const SCRIPT: &str = "text/javascript; charset=utf-8";
const JSON: &str = "application/json";

/// Faults of skeletons that the page offers; a person may write others.
const FAULTS: [&str; 9] = [
    "joint misplaced",
    "joint outside the mesh",
    "joints missing",
    "too many joints",
    "wrong parent",
    "left and right swapped",
    "weights bleed over",
    "parts without weights",
    "not at rest",
];
/// Letters of a comment.
const COMMENT: usize = 4000;
/// Faults of an asset, and letters of each.
const MARKS: (usize, usize) = (24, 80);

/// A decision as the page sends it: about which asset, and all that holds of it now.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Sent {
    name: String,
    digest: String,
    verdict: String,
    category: String,
    faults: Vec<String>,
    comment: String,
    /// What the page took to hold before; where something else does, another window decided meanwhile.
    #[serde(default)]
    was: Option<Record>,
}

/// What holds of an asset.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Record {
    verdict: String,
    category: String,
    faults: Vec<String>,
    comment: String,
}

impl Record {
    /// Tells what is too long; what stood there before, as it may have been written by hand, is not.
    fn check_length(&self, was: Option<&Self>) -> Result<(), String> {
        if self.comment.chars().count() > COMMENT && was.is_none_or(|was| was.comment != self.comment) {
            return Err(format!("a comment has at most {COMMENT} letters"));
        }
        let long = self.faults.len() > MARKS.0 || self.faults.iter().any(|f| f.chars().count() > MARKS.1);
        if long && !was.is_some_and(|was| self.faults.iter().all(|fault| was.faults.contains(fault))) {
            return Err(format!("at most {} faults, of at most {} letters each", MARKS.0, MARKS.1));
        }
        Ok(())
    }

    fn decision(self) -> Result<Decision, String> {
        let verdict = match self.verdict.as_str() {
            "accept" => Verdict::Accept,
            "reject" => Verdict::Reject,
            "-" => Verdict::Open,
            other => return Err(format!("`{other}` is no verdict")),
        };
        let category = match self.category.as_str() {
            "" => None,
            name => Some(name.parse()?),
        };
        Ok(Decision { verdict, category, faults: self.faults, comment: self.comment.trim().to_owned() })
    }
}

#[derive(Serialize)]
struct Shown<'a> {
    #[serde(flatten)]
    card: &'a Card,
    picture: bool,
    decision: Option<Value>,
}

/// Answers a request.
pub fn answer(review: &Review, request: &Request, token: &Token) -> Answer {
    match admit(request, token).and_then(|path| route(review, request, path)) {
        Ok(answer) | Err(answer) => answer,
    }
}

fn route(review: &Review, request: &Request, path: &str) -> Result<Answer, Answer> {
    let get = match request.method.as_str() {
        "GET" => true,
        "POST" => false,
        _ => return Err(Answer::refusal(405, "GET and POST alone")),
    };
    if let Some((_, kind, text)) = PAGE.iter().find(|(name, ..)| get && *name == path) {
        return Ok(Answer::found(kind, *text));
    }
    match path {
        "assets" if get => assets(review),
        "decide" if !get => decide(review, request),
        _ if get => picture(review, path),
        _ => Err(Answer::refusal(404, "there is no such thing")),
    }
}

fn assets(review: &Review) -> Result<Answer, Answer> {
    let cards = &review.deck.cards;
    let state = review.ledger.read(cards).map_err(|e| Answer::refusal(409, &e.to_string()))?;
    let shown = cards.iter().zip(&state.of).map(|(card, decision)| Shown {
        card,
        picture: review.pictures.can(card),
        decision: (!decision.is_empty()).then(|| told(decision)),
    });
    let shown: Vec<Shown> = shown.collect();
    let all = json!({
        "title": review.title, "corpus": review.corpus.display().to_string(),
        "decisions": review.ledger.path().display().to_string(),
        "unreadable": review.deck.unreadable, "told": state.told, "faults": FAULTS,
        "categories": Category::ALL.map(Category::name), "assets": shown,
    });
    Ok(Answer::found(JSON, all.to_string()))
}

fn told(decision: &Decision) -> Value {
    json!({
        "verdict": decision.verdict.to_string(), "category": decision.category.map_or("", Category::name),
        "faults": decision.faults, "comment": decision.comment,
    })
}

fn decide(review: &Review, request: &Request) -> Result<Answer, Answer> {
    // A form of another site cannot send this type unasked.
    if request.header("content-type")? != Some(JSON) {
        return Err(Answer::refusal(415, "a decision is sent as application/json"));
    }
    let wrong = |text: String| Answer::refusal(400, &text);
    let sent: Sent = serde_json::from_slice(&request.body).map_err(|e| wrong(format!("no decision: {e}")))?;
    let cards = &review.deck.cards;
    let key = (&sent.name, &sent.digest);
    // By what it is, not by its number: the page may be older than the server.
    let Ok(index) = cards.binary_search_by(|card| (&card.name, &card.digest).cmp(&key)) else {
        return Err(Answer::refusal(404, &format!("`{}` is not here; load the page anew", sent.name)));
    };
    let Sent { verdict, category, faults, comment, was, .. } = sent;
    let record = Record { verdict, category, faults, comment };
    record.check_length(was.as_ref()).map_err(wrong)?;
    let decision = record.decision().map_err(wrong)?;
    let was = was.map(Record::decision).transpose().map_err(wrong)?;
    match review.ledger.decide(cards, index, decision, was.as_ref()) {
        Ok(decided) => Ok(Answer::found(JSON, json!({ "decided": decided }).to_string())),
        Err(CurateError::Newer { decision, .. }) => {
            Err(Answer::conflict(JSON, json!({ "newer": told(&decision) }).to_string()))
        }
        Err(e) => Err(Answer::refusal(409, &e.to_string())),
    }
}

/// `picture/12/large-dark.png`
fn picture(review: &Review, path: &str) -> Result<Answer, Answer> {
    let missing = || Answer::refusal(404, "there is no such thing");
    let (number, kind) = path.strip_prefix("picture/").and_then(|p| p.split_once('/')).ok_or_else(missing)?;
    let (large, dark) = match kind {
        "small-light.png" => (false, false),
        "small-dark.png" => (false, true),
        "large-light.png" => (true, false),
        "large-dark.png" => (true, true),
        _ => return Err(missing()),
    };
    let index: usize = number.parse().map_err(|_| missing())?;
    let card = review.deck.cards.get(index).ok_or_else(missing)?;
    let png = review.pictures.png(index, card, Kind { large, dark }).map_err(|e| Answer::refusal(404, &e))?;
    Ok(Answer::png(png))
}
