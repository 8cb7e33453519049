/* Frames of a CAN bus in C99: packing, alive counter, CRC-16, inverted twin and receive checks.
 *
 * Nothing here allocates memory, and only the headers below are needed. Sending and receiving:
 *
 *     static struct wire_sender sender;
 *     struct wire_frame frames[2];
 *     size_t count = wire_send_NAME(&sender, &values, frames);
 *
 *     static struct wire_receiver receiver;
 *     enum wire_verdict verdict = wire_receive_NAME(&receiver, &frame, now_ns, &values);
 *
 * Senders and receivers start as zeros, one for each message. Give each receiver every frame of its
 * message. For a vital message these are the frames of both identifiers.
 * Multiplication and addition must round separately: -ffp-contract=off.
 */
#ifndef WIRE_H
#define WIRE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define WIRE_BYTES_MAX 8U
#define WIRE_FRAMES_MAX 2U      /* Frames of one transmission: a vital message has a twin. */
#define WIRE_TWIN_NS 20000000   /* Maximum time between the two halves of a vital pair. */
#define WIRE_STEP_MAX 3U        /* Largest step of the alive counter that counts as lost frames. */

enum wire_protection { WIRE_NONE, WIRE_SAFETY, WIRE_VITAL };
enum wire_kind { WIRE_FLOAT, WIRE_INT, WIRE_BOOL, WIRE_ENUM };

/* Results of the receive checks. All but the first two reject a frame. */
enum wire_verdict {
    WIRE_ACCEPTED,
    WIRE_FIRST_HALF, /* A first half waits for its twin. */
    WIRE_WRONG_LENGTH,
    WIRE_WRONG_CRC,
    WIRE_STUCK_COUNTER,
    WIRE_JUMPED_COUNTER,
    WIRE_INVALID_VALUE, /* A value is outside its range or table. */
    WIRE_ALONE,         /* A first half waits; the one before it never had a twin. */
    WIRE_NO_FIRST,      /* A twin without a first half. */
    WIRE_LATE_TWIN,
    WIRE_NOT_INVERSE,
    WIRE_OTHER_ID       /* The frame belongs to another message. */
};

struct wire_frame {
    uint32_t id; /* One of 29 bits has the highest bit set. */
    uint8_t length;
    uint8_t data[WIRE_BYTES_MAX];
};

struct wire_field {
    const char *name;
    enum wire_kind kind;
    size_t offset; /* Place of the value in the structure of the message. */
};

struct wire_message {
    const char *name;
    uint32_t id;
    uint32_t twin_id;
    uint8_t length; /* Bytes of the frame, with counter and CRC. */
    enum wire_protection protection;
    uint16_t crc;       /* State of the CRC after the data identifier, which is never sent. */
    uint16_t twin_crc;
    int64_t period_ns;  /* 0 for a message that is not cyclic. */
    int64_t timeout_ns; /* Age at which the message counts as lost; 0: never. */
    size_t size;        /* Bytes of the structure. */
    size_t count;       /* Number of fields. */
    const struct wire_field *fields;
    bool (*pack)(const void *from, uint64_t *bits); /* False: NaN, or a value without a name. */
    bool (*unpack)(uint64_t bits, void *to);        /* False: a value out of range or table. */
};

struct wire_sender {
    uint8_t counter; /* Alive counter of the next transmission. */
};

struct wire_receiver {
    int64_t silence_ns; /* Silence after which any counter is a new start; 0: the timeout. */
    bool heard;
    bool refused;
    int64_t heard_ns;   /* Last frame of the accepted stream, counting on or stuck. */
    int64_t refused_ns; /* Last frame whose counter jumped. */
    uint8_t value;
    uint8_t candidate;
    uint8_t lost;      /* Frames lost before the last accepted one. */
    uint8_t last;      /* Counter before the frame that was checked last. */
    bool waiting;      /* A first half waits for its twin. */
    uint64_t first;
    int64_t first_ns;
    bool received;     /* Values were accepted, at received_ns. */
    int64_t received_ns;
};

/* Write the frames of one transmission and return their number. It is 0, and the counter stays, if
 * a value is NaN or not in its table: the receivers then assume the restrictive state. A number
 * beyond the range of its signal is sent as the end of the range. */
size_t wire_encode(const struct wire_message *message, struct wire_sender *sender,
                   const void *values, struct wire_frame frames[WIRE_FRAMES_MAX]);

/* Check a received frame; `values` changes only when the verdict is WIRE_ACCEPTED. */
enum wire_verdict wire_decode(const struct wire_message *message, struct wire_receiver *receiver,
                              const struct wire_frame *frame, int64_t at_ns, void *values);

/* Whether accepted values are there that are not older than the timeout of the message. */
bool wire_is_fresh(const struct wire_message *message, const struct wire_receiver *receiver,
                   int64_t now_ns);

/* The message with this identifier, also that of a twin; NULL for an unknown identifier. */
const struct wire_message *wire_find(uint32_t id);

/* messages */

#ifdef __cplusplus
}
#endif

#endif
