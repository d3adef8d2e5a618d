//! Memory of a node whose services are flooded: a client sends thousands of requests, faster than
//! they are served, and reads no reply.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

mod common;

use common::{client, client_node, minimal};
use ros2_client::rcl_interfaces as rcl;
use std::time::Duration;
use test_support::process::Running;

const DOMAIN: u16 = 15;
/// Requests sent to each service.
const REQUESTS: usize = 5000;
/// Growth during the flood, kB: replies of a second, and for each service the newest requests and
/// up to 4 MiB that RustDDS withholds (in two copies) while a fragment of an earlier request is
/// missing.
const LARGEST_GROWTH: u64 = 40 * 1024;
/// Growth that stays, kB: the newest requests of each service.
const LASTING_GROWTH: u64 = 16 * 1024;

/// Largest resident memory while `send` runs and 2 s after, kB.
fn flood(node: &Running, what: &str, mut send: impl FnMut() -> bool) -> u64 {
    let (mut sent, mut most) = (0, 0);
    for i in 0..REQUESTS {
        sent += usize::from(send());
        if i % 100 == 0 {
            most = most.max(node.memory());
        }
    }
    for _ in 0..20 {
        std::thread::sleep(Duration::from_millis(100));
        most = most.max(node.memory());
    }
    let threads = node.threads();
    assert!(sent > REQUESTS / 2 && threads < 30, "{what}: {sent} requests, {threads} threads");
    most
}

#[test]
fn a_flood_of_requests_does_not_grow_the_node() {
    let node = minimal(DOMAIN, &[], &[]);
    let mut own = client_node(DOMAIN);
    let describe = client::<rcl::DescribeParametersRequest, rcl::DescribeParametersResponse>(
        &mut own,
        "/minimal/describe_parameters",
        "DescribeParameters",
    );
    let get = client::<rcl::GetParametersRequest, rcl::GetParametersResponse>(
        &mut own,
        "/minimal/get_parameters",
        "GetParameters",
    );
    let types = client::<rcl::GetParameterTypesRequest, rcl::GetParameterTypesResponse>(
        &mut own,
        "/minimal/get_parameter_types",
        "GetParameterTypes",
    );
    // Requests sent before both sides have discovered each other go nowhere.
    std::thread::sleep(Duration::from_secs(2));
    let before = node.memory();

    // Replies of 22 kB.
    let request = rcl::DescribeParametersRequest { names: vec!["markers.size".to_owned(); 150] };
    let long_replies =
        flood(&node, "long replies", || describe.send_request(request.clone()).is_ok());
    let request = rcl::GetParametersRequest { names: vec!["x".repeat(30_000)] };
    let long_requests = flood(&node, "long requests", || get.send_request(request.clone()).is_ok());
    let request = rcl::GetParameterTypesRequest { names: vec!["x".repeat(30_000)] };
    let more_requests =
        flood(&node, "more requests", || types.send_request(request.clone()).is_ok());

    let growth = long_replies.max(long_requests).max(more_requests).saturating_sub(before);
    assert!(growth < LARGEST_GROWTH, "grew by {growth} kB from {before} kB");
    let lasting = || node.memory().saturating_sub(before);
    for _ in 0..200 {
        if lasting() < LASTING_GROWTH {
            break;
        }
        std::thread::sleep(Duration::from_millis(100));
    }
    assert!(lasting() < LASTING_GROWTH, "{} kB stay", lasting());
}
