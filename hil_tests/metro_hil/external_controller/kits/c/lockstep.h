/* Client of the bench in virtual time: docs/reference/lockstep_interface.md of the bench.
 *
 * The bench starts this program and speaks first. After `hello` both sides use the binary form:
 * the bench sends a grant with everything received so far, the controller answers with a yield.
 */
#ifndef LOCKSTEP_H
#define LOCKSTEP_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "wire.h"

#ifdef __cplusplus
extern "C" {
#endif

enum lockstep_event {
    LOCKSTEP_GRANT,
    LOCKSTEP_STOP, /* The run is over: answer once more, then end. */
    LOCKSTEP_END   /* The bench has closed the connection. */
};

/* Read the message `hello`, a line of JSON. Return NULL if the bench sent none. The text stays until
 * the first call of lockstep_wait. */
const char *lockstep_hello(void);

/* Read a value of the hello by its path, such as "told/line/stations/2/stop_m". Return false if
 * there is no such value. */
bool lockstep_number(const char *hello, const char *path, double *value);
bool lockstep_text(const char *hello, const char *path, char *text, size_t size);

/* Answer hello. `next_ns` is the instant of the first grant. */
void lockstep_ready(const char *name, int64_t next_ns);
void lockstep_refuse(const char *reason);

/* Wait for the next message of the bench. */
enum lockstep_event lockstep_wait(int64_t *now_ns);

/* Take what the grant brought, in this order. Each returns false when there is no more. */
bool lockstep_frame(struct wire_frame *frame, int64_t *at_ns);
bool lockstep_serial(const uint8_t **data, size_t *length, int64_t *at_ns);
bool lockstep_radio(const char **key, size_t *key_length, const uint8_t **data, size_t *length,
                    int64_t *at_ns);

/* Add to the next yield: frames first, then radio messages. Return false if it is full. */
bool lockstep_send(const struct wire_frame *frame);
bool lockstep_send_radio(const char *key, const uint8_t *data, size_t length);

/* Answer the grant or the stop. The bench wakes the controller again at `next_ns`. */
void lockstep_yield(int64_t now_ns, int64_t next_ns);

#ifdef __cplusplus
}
#endif

#endif
