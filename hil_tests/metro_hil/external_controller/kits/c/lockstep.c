/* Implementation of lockstep.h for systems with POSIX read and write. */
#include "lockstep.h"

#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#define RECORD_MAX 1048576U /* Longest message of the protocol. */
#define YIELD_MAX 65536U
#define YIELD_HEAD 27U
#define GRANT_HEAD 15U
#define NUMBER_MAX 40U

static uint8_t record[RECORD_MAX + 1U];
static size_t record_length;
static size_t record_at;
static unsigned int frames_left;
static unsigned int chunks_left;
static unsigned int messages_left;

static uint8_t sent[YIELD_MAX];
static size_t sent_length = YIELD_HEAD;
static unsigned int frames_sent;
static unsigned int messages_sent;

/* Bytes */

static bool read_all(uint8_t *to, size_t length)
{
    size_t done = 0U;
    bool open = true;
    while (open && (done < length)) {
        const ssize_t count = read(STDIN_FILENO, &to[done], length - done);
        open = count > 0;
        done += open ? (size_t)count : 0U;
    }
    return open;
}

static void write_all(const uint8_t *from, size_t length)
{
    size_t done = 0U;
    bool open = true;
    while (open && (done < length)) {
        const ssize_t count = write(STDOUT_FILENO, &from[done], length - done);
        open = count > 0;
        done += open ? (size_t)count : 0U;
    }
}

static uint64_t load(const uint8_t *from, unsigned int bytes)
{
    uint64_t value = 0U;
    for (unsigned int at = 0U; at < bytes; at++) {
        value |= (uint64_t)from[at] << (8U * at);
    }
    return value;
}

static void store(uint64_t value, uint8_t *to, unsigned int bytes)
{
    for (unsigned int at = 0U; at < bytes; at++) {
        to[at] = (uint8_t)((value >> (8U * at)) & 0xFFU);
    }
}

static void write_text(const char *text)
{
    write_all((const uint8_t *)text, strlen(text));
}

/* Hello: one line of JSON */

const char *lockstep_hello(void)
{
    size_t length = 0U;
    while ((length < RECORD_MAX) && read_all(&record[length], 1U) && (record[length] != '\n')) {
        length++;
    }
    record[length] = 0U;
    return (length > 0U) ? (const char *)record : NULL;
}

static const char *after_blanks(const char *at)
{
    while ((*at == ' ') || (*at == ',') || (*at == ':')) {
        at++;
    }
    return at;
}

/* The first character after the value that begins at `at`. */
static const char *after_value(const char *at)
{
    int depth = 0;
    bool text = false;
    bool more = *at != '\0';
    while (more) {
        if (text) {
            if ((*at == '\\') && (at[1] != '\0')) {
                at++;
            } else if (*at == '"') {
                text = false;
            } else {
                /* A character of the text. */
            }
        } else if (*at == '"') {
            text = true;
        } else if ((*at == '{') || (*at == '[')) {
            depth++;
        } else if ((*at == '}') || (*at == ']')) {
            depth--;
        } else {
            /* A character of a number or a word. */
        }
        at++;
        more = (*at != '\0') &&
               (text || (depth > 0) ||
                ((*at != ',') && (*at != ':') && (*at != '}') && (*at != ']')));
    }
    return at;
}

/* The member called `name`, or with this number, of the object or array at `at`; NULL without. */
static const char *member(const char *at, const char *name, size_t length)
{
    const char *found = NULL;
    const bool object = *at == '{';
    unsigned long wanted = object ? 0UL : strtoul(name, NULL, 10);
    if (object || (*at == '[')) {
        at = after_blanks(at + 1);
        while ((found == NULL) && (*at != '\0') && (*at != '}') && (*at != ']')) {
            if (object) {
                const char *key = at + 1;
                at = after_blanks(after_value(at));
                if ((strncmp(key, name, length) == 0) && (key[length] == '"')) {
                    found = at;
                }
            } else if (wanted == 0UL) {
                found = at;
            } else {
                wanted--;
            }
            at = after_blanks(after_value(at));
        }
    }
    return found;
}

static const char *value_of(const char *hello, const char *path)
{
    const char *at = hello;
    while ((at != NULL) && (*path != '\0')) {
        const size_t length = strcspn(path, "/");
        at = member(after_blanks(at), path, length);
        path += length;
        path += (*path == '/') ? 1 : 0;
    }
    return at;
}

bool lockstep_number(const char *hello, const char *path, double *value)
{
    const char *at = value_of(hello, path);
    bool found = (at != NULL) && ((*at == '-') || ((*at >= '0') && (*at <= '9')));
    if (found) {
        *value = strtod(at, NULL);
    }
    return found;
}

bool lockstep_text(const char *hello, const char *path, char *text, size_t size)
{
    const char *at = value_of(hello, path);
    bool found = (at != NULL) && (*at == '"');
    size_t length = 0U;
    if (found) {
        for (at++; (*at != '"') && (*at != '\0') && (length + 1U < size); at++) {
            text[length] = *at;
            length++;
        }
        found = *at == '"';
    }
    text[length] = '\0';
    return found;
}

static const char *decimal(int64_t value, char text[NUMBER_MAX])
{
    uint64_t rest = (uint64_t)((value < 0) ? -value : value);
    size_t at = NUMBER_MAX - 1U;
    text[at] = '\0';
    do {
        at--;
        text[at] = (char)('0' + (int)(rest % 10U));
        rest /= 10U;
    } while (rest > 0U);
    if (value < 0) {
        at--;
        text[at] = '-';
    }
    return &text[at];
}

void lockstep_ready(const char *name, int64_t next_ns)
{
    char text[NUMBER_MAX];
    write_text("{\"type\":\"ready\",\"version\":1,\"form\":\"binary\",\"name\":\"");
    write_text(name);
    write_text("\",\"next_wakeup_ns\":");
    write_text(decimal(next_ns, text));
    write_text("}\n");
}

void lockstep_refuse(const char *reason)
{
    write_text("{\"type\":\"refuse\",\"reason\":\"");
    write_text(reason);
    write_text("\"}\n");
}

/* Grants and yields: records in the binary form */

enum lockstep_event lockstep_wait(int64_t *now_ns)
{
    uint8_t head[4];
    enum lockstep_event event = LOCKSTEP_END;
    frames_left = 0U;
    chunks_left = 0U;
    messages_left = 0U;
    if (read_all(head, sizeof head)) {
        record_length = (size_t)load(head, 4U);
        if ((record_length >= 9U) && (record_length <= RECORD_MAX) &&
            read_all(record, record_length)) {
            *now_ns = (int64_t)load(&record[1], 8U);
            if (record[0] == 2U) {
                event = LOCKSTEP_STOP;
            } else if ((record[0] == 1U) && (record_length >= GRANT_HEAD)) {
                frames_left = (unsigned int)load(&record[9], 2U);
                chunks_left = (unsigned int)load(&record[11], 2U);
                messages_left = (unsigned int)load(&record[13], 2U);
                record_at = GRANT_HEAD;
                event = LOCKSTEP_GRANT;
            } else {
                /* Not a message of the protocol: end. */
            }
        }
    }
    return event;
}

bool lockstep_frame(struct wire_frame *frame, int64_t *at_ns)
{
    const bool more = (frames_left > 0U) && ((record_at + 19U) <= record_length);
    if (more) {
        const uint8_t *from = &record[record_at];
        *at_ns = (int64_t)load(from, 8U);
        frame->id = (uint32_t)load(&from[8], 2U);
        frame->length = from[10];
        (void)memcpy(frame->data, &from[11], WIRE_BYTES_MAX);
        record_at += 19U;
        frames_left--;
    }
    return more;
}

bool lockstep_serial(const uint8_t **data, size_t *length, int64_t *at_ns)
{
    bool more = (frames_left == 0U) && (chunks_left > 0U) && ((record_at + 12U) <= record_length);
    if (more) {
        *at_ns = (int64_t)load(&record[record_at], 8U);
        *length = (size_t)load(&record[record_at + 8U], 4U);
        record_at += 12U;
        more = *length <= (record_length - record_at);
        *data = &record[record_at];
        record_at += more ? *length : 0U;
        chunks_left--;
    }
    return more;
}

bool lockstep_radio(const char **key, size_t *key_length, const uint8_t **data, size_t *length,
                    int64_t *at_ns)
{
    bool more = (frames_left == 0U) && (chunks_left == 0U) && (messages_left > 0U) &&
                ((record_at + 14U) <= record_length);
    if (more) {
        *at_ns = (int64_t)load(&record[record_at], 8U);
        *key_length = (size_t)load(&record[record_at + 8U], 2U);
        *length = (size_t)load(&record[record_at + 10U], 4U);
        record_at += 14U;
        more = (*key_length + *length) <= (record_length - record_at);
        *key = (const char *)&record[record_at];
        *data = &record[record_at + *key_length];
        record_at += more ? (*key_length + *length) : 0U;
        messages_left--;
    }
    return more;
}

bool lockstep_send(const struct wire_frame *frame)
{
    const bool room = (messages_sent == 0U) && ((sent_length + 11U) <= YIELD_MAX);
    if (room) {
        uint8_t *to = &sent[sent_length];
        store(frame->id, to, 2U);
        to[2] = frame->length;
        (void)memcpy(&to[3], frame->data, WIRE_BYTES_MAX);
        sent_length += 11U;
        frames_sent++;
    }
    return room;
}

bool lockstep_send_radio(const char *key, const uint8_t *data, size_t length)
{
    const size_t key_length = strlen(key);
    const bool room = (length < YIELD_MAX) && (key_length < YIELD_MAX) &&
                      ((sent_length + 6U + key_length + length) <= YIELD_MAX);
    if (room) {
        uint8_t *to = &sent[sent_length];
        store(key_length, to, 2U);
        store(length, &to[2], 4U);
        (void)memcpy(&to[6], key, key_length);
        (void)memcpy(&to[6U + key_length], data, length);
        sent_length += 6U + key_length + length;
        messages_sent++;
    }
    return room;
}

void lockstep_yield(int64_t now_ns, int64_t next_ns)
{
    store(sent_length - 4U, &sent[0], 4U);
    sent[4] = 3U;
    store((uint64_t)now_ns, &sent[5], 8U);
    store((uint64_t)next_ns, &sent[13], 8U);
    store(frames_sent, &sent[21], 2U);
    store(0U, &sent[23], 2U); /* The controller never writes to the tag reader. */
    store(messages_sent, &sent[25], 2U);
    write_all(sent, sent_length);
    sent_length = YIELD_HEAD;
    frames_sent = 0U;
    messages_sent = 0U;
}
