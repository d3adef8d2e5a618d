//! The report: every figure is in it, and a real browser draws it without fault, in the light and
//! in the dark.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of a test")]

mod browser;

use browser::{Browser, installed};
use rig_simulator::parallel;
use std::path::Path;
use volant_test::{
    live::{ImageSequence, Scenario},
    paper::{
        Made, NAMES, curves::Curves, occlusion::figure_6, peers, report::render, stages::Stages,
        stationary::figure_9,
    },
};

/// What `volant-peers` wrote in a run of its own, so that its figures are drawn here without the
/// large OpenCV.
const PEERS: [(&str, &str); 6] = [
    ("fig-2.csv", include_str!("data/fig-2.csv")),
    ("fig-7.csv", include_str!("data/fig-7.csv")),
    ("fig-11.csv", include_str!("data/fig-11.csv")),
    ("fig-12.csv", include_str!("data/fig-12.csv")),
    ("table-1.csv", include_str!("data/table-1.csv")),
    ("bench.csv", include_str!("data/bench.csv")),
];

/// Every figure, from runs that are as short as they may be, and the page that shows them.
fn make() -> (Vec<Made>, String) {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    for (name, text) in PEERS {
        std::fs::write(folder.join(name), text).unwrap();
    }
    let threads = parallel::processors();
    let stages = Stages::of(1, threads).unwrap();
    let scenario = Scenario::swing(1, 4.0).unwrap();
    let images = ImageSequence::render(&scenario, threads, |_, _| {}).unwrap();
    let curves = Curves::of(&scenario, &images).unwrap();
    let made = vec![
        peers::boards("fig-2", folder).unwrap(),
        stages.figure_4().unwrap(),
        stages.figure_5().unwrap(),
        figure_6(1, threads, |_| {}).unwrap(),
        peers::boards("fig-7", folder).unwrap(),
        figure_9(1).unwrap(),
        peers::table_1(folder).unwrap(),
        peers::figure_11(folder).unwrap(),
        peers::figure_12(folder).unwrap(),
        curves.figure_13().unwrap(),
        curves.table_2(),
    ];
    let facts =
        vec![("Command".to_owned(), "`cargo test -p volant_test --test report`".to_owned())];
    let page = render(facts, &made, &[("nothing", "a reason why".to_owned())]);
    (made, page)
}

#[test]
fn every_figure_is_in_the_report() {
    let (made, html) = make();
    assert_eq!(made.iter().map(|m| m.name).collect::<Vec<_>>(), NAMES);
    for m in &made {
        assert!(!m.csv.is_empty() && !m.svg.is_empty(), "{}", m.name);
        let words = format!("{}: {} {}", m.name, m.shows, m.published);
        assert!(!words.contains("NaN"), "{words}");
        assert!(!m.values.is_empty(), "{}: published values beside ours", m.name);
        assert!(!m.values.iter().any(|v| v.here.contains("NaN")), "{:?}", m.values);
    }
    for name in NAMES {
        assert!(html.contains(&format!("<section id=\"{name}\">")), "{name}");
    }
    assert_eq!(html.matches("<figure>").count(), NAMES.len());
}

#[test]
fn a_browser_renders_the_report_in_light_and_dark() {
    let Some(program) = installed() else {
        return test_support::skip(
            "no browser renders the report: `make browser` installs one, VOLANT_BROWSER names one",
        );
    };
    let folder = tempfile::tempdir().unwrap();
    let page = folder.path().join("report.html");
    std::fs::write(&page, make().1).unwrap();
    inspect(&program, &page);
}

fn inspect(program: &Path, page: &Path) {
    let mut browser = Browser::start(program, 1280, 900);
    let mut grounds = Vec::new();
    for (scheme, width) in [("light", 1280), ("dark", 1280), ("light", 700)] {
        let device = serde_json::json!({
            "width": width, "height": 900, "deviceScaleFactor": 1, "mobile": false
        });
        browser.call("Emulation.setDeviceMetricsOverride", device);
        browser.open(page, scheme);
        let seen = browser.evaluate(include_str!("browser/inspect.js"));
        let problems: Vec<&str> =
            seen["problems"].as_array().unwrap().iter().map(|p| p.as_str().unwrap()).collect();
        assert!(problems.is_empty(), "{scheme}, {width} px wide:\n{}", problems.join("\n"));
        let figures = seen["figures"].as_u64().unwrap();
        let texts = seen["texts"].as_u64().unwrap();
        assert!(figures > 0 && texts > 20, "{scheme}: {figures} figures, {texts} texts");
        grounds.push(seen["ground"].as_str().unwrap().to_owned());
        let address = format!("file://{}", page.display());
        for event in &browser.events {
            let (method, p) = (event["method"].as_str().unwrap_or(""), &event["params"]);
            match method {
                "Network.requestWillBeSent" => {
                    let url = p["request"]["url"].as_str().unwrap();
                    assert!(
                        url == address || url.starts_with("data:"),
                        "{scheme}: the page requests {url}"
                    );
                }
                "Runtime.exceptionThrown" => panic!("{scheme}: {p}"),
                "Runtime.consoleAPICalled" => {
                    let kind = p["type"].as_str().unwrap();
                    assert!(kind != "error" && kind != "warning", "{scheme}: {p}");
                }
                "Log.entryAdded" => panic!("{scheme}: {}", p["entry"]["text"]),
                _ => {}
            }
        }
    }
    assert_ne!(grounds[0], grounds[1], "the dark is dark");
}
