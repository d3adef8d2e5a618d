//! A client of the server: its socket and its bounded queue.

use super::protocol::{FromClient, SUBPROTOCOLS, warning};
use parking_lot::Mutex;
use std::{
    collections::HashMap,
    io::ErrorKind,
    net::TcpStream,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicUsize, Ordering},
        mpsc::{Receiver, SyncSender, sync_channel},
    },
    time::Duration,
};
use tungstenite::{
    Error, Message, WebSocket,
    handshake::server::{ErrorResponse, Request, Response},
    http::{HeaderValue, StatusCode},
    protocol::WebSocketConfig,
};

/// Bytes that may wait for a client. Messages beyond are dropped: a slow viewer sees fewer images
/// and delays no other client.
const WAITING: usize = 16 << 20;
/// Messages that may wait, whatever their size.
const QUEUE: usize = 4096;
/// Period of polling the socket while the queue is empty.
const LOOK: Duration = Duration::from_millis(10);
/// Time limit of the handshake.
const HANDSHAKE: Duration = Duration::from_secs(5);

/// A client as the server's threads share it.
pub(super) struct Client {
    queue: SyncSender<Message>,
    /// Bytes in the queue.
    waiting: AtomicUsize,
    dropped: AtomicUsize,
    /// The client's subscription of each channel.
    pub subscriptions: Mutex<HashMap<u32, u32>>,
    closed: AtomicBool,
}

impl Client {
    /// A client, and the receiving end of its queue.
    pub fn new() -> (Arc<Self>, Receiver<Message>) {
        let (queue, outgoing) = sync_channel(QUEUE);
        let client = Self {
            queue,
            waiting: AtomicUsize::new(0),
            dropped: AtomicUsize::new(0),
            subscriptions: Mutex::default(),
            closed: AtomicBool::new(false),
        };
        (Arc::new(client), outgoing)
    }

    /// Queues a message; never blocks.
    pub fn send(&self, message: Message) {
        let bytes = message.len();
        if self.waiting.fetch_add(bytes, Ordering::AcqRel) + bytes > WAITING
            || self.queue.try_send(message).is_err()
        {
            self.waiting.fetch_sub(bytes, Ordering::AcqRel);
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// The client's subscription of a channel.
    pub fn subscription(&self, channel: u32) -> Option<u32> {
        self.subscriptions.lock().get(&channel).copied()
    }

    pub fn close(&self) {
        self.closed.store(true, Ordering::Release);
    }

    pub fn is_closed(&self) -> bool {
        self.closed.load(Ordering::Acquire)
    }
}

/// Serves a client until it or the server closes. `hello` is sent first, `handle` receives
/// requests.
pub(super) fn serve(
    stream: TcpStream,
    client: &Client,
    outgoing: &Receiver<Message>,
    hello: Vec<String>,
    mut handle: impl FnMut(FromClient),
) -> Result<(), Error> {
    stream.set_nodelay(true)?;
    stream.set_read_timeout(Some(HANDSHAKE))?;
    stream.set_write_timeout(Some(HANDSHAKE))?;
    let config = WebSocketConfig::default()
        .max_message_size(Some(1 << 20))
        .max_frame_size(Some(1 << 20))
        .write_buffer_size(64 << 10)
        .max_write_buffer_size(WAITING);
    let mut socket =
        tungstenite::accept_hdr_with_config(stream, choose, Some(config)).map_err(|e| match e {
            tungstenite::HandshakeError::Failure(error) => error,
            // The socket is blocking: an interrupted handshake has timed out.
            tungstenite::HandshakeError::Interrupted(_) => Error::ConnectionClosed,
        })?;
    socket.get_mut().set_nonblocking(true)?;
    for text in hello {
        send(&mut socket, Message::text(text))?;
    }
    let mut reported = 0;
    while !client.is_closed() {
        // The client has a sender of the queue: an error is the timeout.
        if let Ok(first) = outgoing.recv_timeout(LOOK) {
            for message in std::iter::once(first).chain(outgoing.try_iter().take(256)) {
                client.waiting.fetch_sub(message.len(), Ordering::AcqRel);
                send(&mut socket, message)?;
            }
        }
        done(socket.flush())?;
        loop {
            match socket.read() {
                Ok(Message::Text(text)) => match serde_json::from_str(&text) {
                    Ok(request) => handle(request),
                    Err(reason) => {
                        let text = warning(&format!("not understood: {reason}"));
                        send(&mut socket, Message::text(text))?;
                    }
                },
                Ok(Message::Close(_)) | Err(Error::ConnectionClosed) => return Ok(()),
                // Publishing is not offered, and the crate answers pings.
                Ok(_) => {}
                Err(Error::Io(e)) if e.kind() == ErrorKind::WouldBlock => break,
                Err(error) => return Err(error),
            }
        }
        let dropped = client.dropped.load(Ordering::Relaxed);
        if dropped >= reported + 100 {
            reported = dropped;
            let text = format!(
                "{dropped} messages were dropped: this connection is too slow for its \
                 subscriptions"
            );
            send(&mut socket, Message::text(warning(&text)))?;
        }
    }
    let _ = socket.close(None);
    let _ = socket.flush();
    Ok(())
}

/// Selects the first supported protocol that the client offers; rejects a client that offers only
/// others.
#[allow(clippy::result_large_err, reason = "the crate's own callback")]
fn choose(request: &Request, mut response: Response) -> Result<Response, ErrorResponse> {
    const HEADER: &str = "Sec-WebSocket-Protocol";
    let offered: Vec<&str> = request
        .headers()
        .get_all(HEADER)
        .iter()
        .filter_map(|v| v.to_str().ok())
        .flat_map(|v| v.split(',').map(str::trim))
        .collect();
    match SUBPROTOCOLS.iter().find(|p| offered.contains(p)) {
        Some(protocol) => {
            response.headers_mut().insert(HEADER, HeaderValue::from_static(protocol));
            Ok(response)
        }
        None => {
            let mut response = ErrorResponse::new(Some(format!(
                "this is a Foxglove WebSocket server; ask for the protocol {}\n",
                SUBPROTOCOLS.join(" or ")
            )));
            *response.status_mut() = StatusCode::BAD_REQUEST;
            Err(response)
        }
    }
}

fn send(socket: &mut WebSocket<TcpStream>, message: Message) -> Result<(), Error> {
    match done(socket.write(message)) {
        // The client does not read: the message is dropped.
        Err(Error::WriteBufferFull(_)) => Ok(()),
        other => other,
    }
}

/// Ignores a full socket: the rest waits in the crate's bounded buffer.
fn done(result: Result<(), Error>) -> Result<(), Error> {
    match result {
        Err(Error::Io(e)) if e.kind() == ErrorKind::WouldBlock => Ok(()),
        other => other,
    }
}
