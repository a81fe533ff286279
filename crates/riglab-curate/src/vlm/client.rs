//! One request to `/chat/completions`.

use std::time::Duration;

use base64::Engine;
use serde_json::{Value, json};

use crate::config::VlmConfig;

/// Answers longer than this are no answers.
const MOST_BYTES: u64 = 1 << 20;

pub(super) struct Client {
    agent: ureq::Agent,
    url: String,
    model: String,
    key: Option<String>,
}

/// Why there is no answer.
pub(super) enum Fault {
    /// Too many questions; seconds to wait, if it says.
    Busy(Option<f64>),
    /// It may go better next time.
    Passing(String),
    /// It will not.
    Final(String),
}

impl Client {
    pub(super) fn new(config: &VlmConfig, key: Option<String>) -> Self {
        let mut builder = ureq::Agent::config_builder()
            .timeout_global(Some(Duration::from_secs_f64(config.timeout_s)))
            .http_status_as_error(false)
            // Pictures go where the config says and nowhere else.
            .max_redirects(0)
            .max_redirects_will_error(false);
        if is_loopback(&config.url) {
            // What runs on this machine is not asked through a proxy.
            builder = builder.proxy(None);
        }
        let url = format!("{}/chat/completions", config.url.trim_end_matches('/'));
        Self { agent: builder.build().into(), url, model: config.model.clone(), key }
    }

    /// Asks about pictures (PNG); gives the answer's text.
    pub(super) fn ask(&self, prompt: &str, pictures: &[Vec<u8>], temperature: f64) -> Result<String, Fault> {
        let picture = |png: &Vec<u8>| {
            let data = base64::engine::general_purpose::STANDARD.encode(png);
            json!({"type": "image_url", "image_url": {"url": format!("data:image/png;base64,{data}")}})
        };
        let mut content = vec![json!({"type": "text", "text": prompt})];
        content.extend(pictures.iter().map(picture));
        let body = json!({
            "model": self.model,
            "messages": [{"role": "user", "content": content}],
            "temperature": temperature,
            "max_tokens": 64,
        });
        let mut request = self.agent.post(&self.url).header("Content-Type", "application/json");
        if let Some(key) = &self.key {
            request = request.header("Authorization", format!("Bearer {key}"));
        }
        // The message of a transport never holds the key.
        let passing = |e: ureq::Error| Fault::Passing(format!("the endpoint does not answer ({e})"));
        let mut response = request.send(body.to_string()).map_err(passing)?;
        let status = response.status().as_u16();
        let after = response.headers().get("retry-after").and_then(|v| v.to_str().ok()?.trim().parse::<f64>().ok());
        let after = after.filter(|s| s.is_finite() && *s >= 0.0);
        let text = response.body_mut().with_config().limit(MOST_BYTES).read_to_string();
        match status {
            200..=299 => {}
            429 => return Err(Fault::Busy(after)),
            503 if after.is_some() => return Err(Fault::Busy(after)),
            408 | 425 | 500.. => return Err(Fault::Passing(format!("the endpoint answered with status {status}"))),
            _ => {
                let told: String = text.unwrap_or_default().chars().filter(|c| !c.is_control()).take(120).collect();
                return Err(Fault::Final(format!("the endpoint refuses with status {status}: {told}")));
            }
        }
        let text = text.map_err(passing)?;
        content_of(&text).ok_or_else(|| Fault::Passing("the endpoint's answer is not of this protocol".into()))
    }
}

/// The text of the first choice: a string, or parts of which some are texts.
fn content_of(text: &str) -> Option<String> {
    let value: Value = serde_json::from_str(text).ok()?;
    match value.pointer("/choices/0/message/content")? {
        Value::String(text) => Some(text.clone()),
        Value::Array(parts) => Some(parts.iter().filter_map(|p| p.get("text")?.as_str()).collect::<Vec<_>>().join(" ")),
        // A model that said nothing.
        Value::Null => Some(String::new()),
        _ => None,
    }
}

fn is_loopback(url: &str) -> bool {
    let host = url.split("://").nth(1).unwrap_or("").split(['/', '?']).next().unwrap_or("");
    let host = host.rsplit('@').next().unwrap_or("");
    host.starts_with("127.") || host.starts_with("[::1]") || host.split(':').next() == Some("localhost")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_are_found_in_both_forms() {
        let wrapped = |content: &str| format!(r#"{{"choices": [{{"message": {{"content": {content}}}}}]}}"#);
        assert_eq!(content_of(&wrapped("\"fish\"")).unwrap(), "fish");
        assert_eq!(content_of(&wrapped(r#"[{"type": "text", "text": "a"}, {"type": "x"}]"#)).unwrap(), "a");
        assert_eq!(content_of(&wrapped("null")).unwrap(), "");
        assert_eq!(content_of("{}"), None);
        assert_eq!(content_of("<html>"), None);
    }

    #[test]
    fn this_machine_is_known() {
        assert!(is_loopback("http://127.0.0.1:8000/v1") && is_loopback("http://localhost/v1"));
        assert!(is_loopback("http://[::1]:80") && !is_loopback("https://localhost.example.org/v1"));
    }
}
