/* Lines of the logs, formatted into one buffer; storage/lines.py is the readable reference. */
#ifndef LINES_H
#define LINES_H

#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <stdbool.h>
#include <stdio.h>

#include "number.h"

#define LINES_MAX 1024
#define NS_PER_S 1000000000LL

/* Given by Python: the text of any value, the class of enumeration classes. */
static PyObject *field_text, *enum_type;

struct buffer {
    char *text;
    size_t size, room;
    Py_ssize_t lines;
    PyObject *write; /* Takes the whole lines as bytes, and their number. */
};

/* Make room for `more` bytes and return where they go; NULL without memory. */
static char *reserve(struct buffer *buffer, size_t more)
{
    if (buffer->size + more > buffer->room) {
        size_t room = 2 * (buffer->size + more) + 4096;
        char *text = PyMem_Realloc(buffer->text, room);
        if (!text) {
            PyErr_NoMemory();
            return NULL;
        }
        buffer->text = text;
        buffer->room = room;
    }
    return buffer->text + buffer->size;
}

static int put(struct buffer *buffer, const char *text, size_t size)
{
    char *to = reserve(buffer, size);
    if (!to)
        return -1;
    memcpy(to, text, size);
    buffer->size += size;
    return 0;
}

static int put_character(struct buffer *buffer, char character)
{
    return put(buffer, &character, 1);
}

static char *put_hex(char *to, const uint8_t *data, size_t size)
{
    static const char digits[] = "0123456789ABCDEF";
    for (size_t at = 0; at < size; at++) {
        *to++ = digits[data[at] >> 4];
        *to++ = digits[data[at] & 15];
    }
    return to;
}

/* Write a number of exactly `width` digits. */
static char *put_digits(char *to, unsigned value, int width)
{
    for (int at = width - 1; at >= 0; at--) {
        to[at] = (char)('0' + value % 10);
        value /= 10;
    }
    return to + width;
}

static char *put_whole(char *to, long long value)
{
    char digits[20];
    int count = 0;
    unsigned long long left = value < 0 ? 0ULL - (unsigned long long)value : (unsigned long long)value;
    if (value < 0)
        *to++ = '-';
    do {
        digits[count++] = (char)('0' + left % 10);
    } while (left /= 10);
    while (count)
        *to++ = digits[--count];
    return to;
}

static int put_text(struct buffer *buffer, PyObject *text)
{
    Py_ssize_t size;
    const char *raw = PyUnicode_AsUTF8AndSize(text, &size);
    if (raw)
        return put(buffer, raw, (size_t)size);
    if (!PyErr_ExceptionMatches(PyExc_UnicodeEncodeError))
        return -1;
    PyErr_Clear();
    PyObject *bytes = PyUnicode_AsEncodedString(text, "utf-8", "surrogateescape");
    if (!bytes)
        return -1;
    int failed = put(buffer, PyBytes_AS_STRING(bytes), (size_t)PyBytes_GET_SIZE(bytes));
    Py_DECREF(bytes);
    return failed;
}

static int flush(struct buffer *buffer)
{
    if (!buffer->lines)
        return 0;
    PyObject *block = PyBytes_FromStringAndSize(buffer->text, (Py_ssize_t)buffer->size);
    if (!block)
        return -1;
    Py_ssize_t lines = buffer->lines;
    buffer->size = 0;
    buffer->lines = 0;
    PyObject *done = PyObject_CallFunction(buffer->write, "Nn", block, lines);
    Py_XDECREF(done);
    return done ? 0 : -1;
}

/* Lines of `candump -l`. */
typedef struct {
    PyObject_HEAD
    struct buffer buffer;
    char *middle; /* Text between stamp and identifier. */
    size_t middle_size;
    char seconds[32];
    int seconds_size;
    __int128 second_ns;
} CandumpLines;

static int turn_second(CandumpLines *self, __int128 epoch_ns)
{
    if (flush(&self->buffer) < 0)
        return -1;
    long long second = (long long)(epoch_ns / NS_PER_S);
    if (epoch_ns % NS_PER_S < 0)
        second--;
    self->second_ns = (__int128)second * NS_PER_S;
    self->seconds_size = snprintf(self->seconds, sizeof self->seconds, "(%010lld.", second);
    return 0;
}

/* Begin a line: the stamp, cut to microseconds, and the channel. */
static char *begin_candump(CandumpLines *self, __int128 epoch_ns, size_t more)
{
    __int128 past_ns = epoch_ns - self->second_ns;
    if (past_ns < 0 || past_ns >= NS_PER_S || self->buffer.lines >= LINES_MAX) {
        if (turn_second(self, epoch_ns) < 0)
            return NULL;
        past_ns = epoch_ns - self->second_ns;
    }
    char *to = reserve(&self->buffer, sizeof self->seconds + 6 + self->middle_size + more);
    if (!to)
        return NULL;
    memcpy(to, self->seconds, (size_t)self->seconds_size);
    to = put_digits(to + self->seconds_size, (unsigned)(past_ns / 1000), 6);
    memcpy(to, self->middle, self->middle_size);
    return to + self->middle_size;
}

static void end_line(struct buffer *buffer, char *to)
{
    *to++ = '\n';
    buffer->size = (size_t)(to - buffer->text);
    buffer->lines++;
}

static char *put_identifier(char *to, unsigned id)
{
    to = put_hex(to, &(uint8_t){(uint8_t)(id >> 4)}, 1);
    *to++ = "0123456789ABCDEF"[id & 15];
    return to;
}

/* Write a data frame with an 11-bit identifier. */
static int candump_frame(CandumpLines *self, long long epoch_ns, unsigned id, const uint8_t *data,
                         size_t size)
{
    char *to = begin_candump(self, epoch_ns, 2 * size + 8);
    if (!to)
        return -1;
    to = put_identifier(to, id & 0x7FF);
    *to++ = '#';
    end_line(&self->buffer, put_hex(to, data, size));
    return 0;
}

static PyObject *candump_lines_frame(CandumpLines *self, PyObject *args, PyObject *named)
{
    static char *names[] = {"epoch_ns", "can_id", "data", "extended", "remote", "error", NULL};
    PyObject *stamp;
    unsigned long id;
    Py_buffer data;
    int extended = 0, remote = 0, error = 0, beyond;
    if (!PyArg_ParseTupleAndKeywords(args, named, "O!ky*|$ppp", names, &PyLong_Type, &stamp, &id,
                                     &data, &extended, &remote, &error))
        return NULL;
    size_t size = (size_t)data.len;
    __int128 epoch_ns = PyLong_AsLongLongAndOverflow(stamp, &beyond);
    if (beyond > 0) /* Signed nanoseconds end in 2262. */
        epoch_ns = PyLong_AsUnsignedLongLong(stamp);
    if (beyond < 0 || (beyond && PyErr_Occurred())) {
        PyBuffer_Release(&data);
        return PyErr_Format(PyExc_OverflowError, "%R is no instant", stamp);
    }
    char *to = begin_candump(self, epoch_ns, 2 * size + 32);
    if (to) {
        if (error)
            to += sprintf(to, "%08lX#", (id & 0x1FFFFFFF) | 0x20000000);
        else if (extended)
            to += sprintf(to, "%08lX#", id & 0x1FFFFFFF);
        else
            to += sprintf(to, "%03lX#", id & 0x7FF);
        if (remote && !error)
            to += size > 0 && size <= 8 ? sprintf(to, "R%zu", size) : sprintf(to, "R");
        else
            to = put_hex(to, data.buf, size);
        end_line(&self->buffer, to);
    }
    PyBuffer_Release(&data);
    return to ? Py_NewRef(Py_None) : NULL;
}

static PyObject *candump_lines_flush(CandumpLines *self, PyObject *unused)
{
    return flush(&self->buffer) < 0 ? NULL : Py_NewRef(Py_None);
}

static PyObject *candump_lines_new(PyTypeObject *type, PyObject *args, PyObject *named)
{
    static char *names[] = {"write", "channel", NULL};
    PyObject *write;
    const char *channel;
    if (!PyArg_ParseTupleAndKeywords(args, named, "Os", names, &write, &channel))
        return NULL;
    CandumpLines *self = (CandumpLines *)type->tp_alloc(type, 0);
    if (!self)
        return NULL;
    self->buffer.write = Py_NewRef(write);
    self->middle_size = strlen(channel) + 3;
    self->middle = PyMem_Malloc(self->middle_size + 1);
    if (!self->middle) {
        Py_DECREF(self);
        return PyErr_NoMemory();
    }
    sprintf(self->middle, ") %s ", channel);
    self->seconds_size = snprintf(self->seconds, sizeof self->seconds, "(%010d.", 0);
    return (PyObject *)self;
}

/* The three types begin with the same members, so they share these functions. */
static int lines_traverse(PyObject *self, visitproc visit, void *arg)
{
    Py_VISIT(((CandumpLines *)self)->buffer.write);
    return 0;
}

static int lines_clear(PyObject *self)
{
    Py_CLEAR(((CandumpLines *)self)->buffer.write);
    return 0;
}

static void lines_dealloc(PyObject *self)
{
    PyObject_GC_UnTrack(self);
    lines_clear(self);
    PyMem_Free(((CandumpLines *)self)->buffer.text);
    Py_TYPE(self)->tp_free(self);
}

static void candump_lines_dealloc(PyObject *self)
{
    PyMem_Free(((CandumpLines *)self)->middle);
    lines_dealloc(self);
}

static PyMethodDef candump_lines_methods[] = {
    {"frame", (PyCFunction)(void (*)(void))candump_lines_frame, METH_VARARGS | METH_KEYWORDS, NULL},
    {"flush", (PyCFunction)candump_lines_flush, METH_NOARGS, NULL},
    {NULL},
};

#define LINES_TYPE(type, make, free, functions)                                                   \
    PyVarObject_HEAD_INIT(NULL, 0).tp_name = "bench_core." #type, .tp_basicsize = sizeof(type),    \
    .tp_flags = Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_GC, .tp_new = make,                           \
    .tp_traverse = lines_traverse, .tp_clear = lines_clear, .tp_dealloc = free,                    \
    .tp_methods = functions

static PyTypeObject CandumpLinesType = {
    LINES_TYPE(CandumpLines, candump_lines_new, candump_lines_dealloc, candump_lines_methods)};

/* Rows of a CSV log. */
#define ENUMS_KEPT 256

typedef struct {
    PyObject_HEAD
    struct buffer buffer;
    long long second;
    bool begun;
    PyObject *members[ENUMS_KEPT], *texts[ENUMS_KEPT]; /* Texts of enumeration members, by place. */
} CsvLines;

static int put_python_text(struct buffer *buffer, PyObject *value)
{
    PyObject *text = PyObject_CallOneArg(field_text, value);
    int failed = text ? put_text(buffer, text) : -1;
    Py_XDECREF(text);
    return failed;
}

static int put_member(CsvLines *self, PyObject *value)
{
    size_t at = ((size_t)value >> 4) % ENUMS_KEPT;
    if (self->members[at] != value) {
        PyObject *text = PyObject_CallOneArg(field_text, value);
        if (!text)
            return -1;
        Py_XSETREF(self->members[at], Py_NewRef(value));
        Py_XSETREF(self->texts[at], text);
    }
    return put_text(&self->buffer, self->texts[at]);
}

static int put_float(struct buffer *buffer, double value)
{
    char *to = reserve(buffer, NUMBER_MAX);
    if (!to)
        return -1;
    int size = put_number(to, value);
    if (size) {
        buffer->size += (size_t)size;
        return 0;
    }
    char *text = PyOS_double_to_string(value, 'g', 9, 0, NULL);
    if (!text)
        return -1;
    int failed = put(buffer, text, strlen(text));
    PyMem_Free(text);
    return failed;
}

/* Write one field. All but the usual types are given to Python. */
static int put_field(CsvLines *self, PyObject *value)
{
    struct buffer *buffer = &self->buffer;
    if (PyFloat_CheckExact(value))
        return put_float(buffer, PyFloat_AS_DOUBLE(value));
    if (value == Py_None)
        return 0;
    if (value == Py_True || value == Py_False)
        return put_character(buffer, value == Py_True ? '1' : '0');
    if (PyLong_CheckExact(value)) {
        int beyond;
        long long number = PyLong_AsLongLongAndOverflow(value, &beyond);
        char *to = beyond ? NULL : reserve(buffer, NUMBER_MAX);
        if (!to)
            return beyond ? put_python_text(buffer, value) : -1;
        buffer->size += (size_t)(put_whole(to, number) - to);
        return 0;
    }
    if ((PyObject *)Py_TYPE(Py_TYPE(value)) == enum_type)
        return put_member(self, value);
    if (PyTuple_CheckExact(value)) {
        for (Py_ssize_t at = 0; at < PyTuple_GET_SIZE(value); at++)
            if ((at && put_character(buffer, ' ') < 0) ||
                put_field(self, PyTuple_GET_ITEM(value, at)) < 0)
                return -1;
        return 0;
    }
    return put_python_text(buffer, value);
}

/* The whole second of the first value, which is a number or its text. */
static int second_of(PyObject *first, long long *second)
{
    PyObject *number = PyNumber_Float(first);
    if (!number)
        return -1;
    double value = PyFloat_AS_DOUBLE(number);
    Py_DECREF(number);
    if (!(value > -9e18 && value < 9e18)) {
        PyErr_Format(PyExc_ValueError, "cannot convert %R to a second", first);
        return -1;
    }
    *second = (long long)value;
    return 0;
}

static PyObject *csv_lines_row(CsvLines *self, PyObject *values)
{
    struct buffer *buffer = &self->buffer;
    long long second;
    if (!PyTuple_Check(values) || PyTuple_GET_SIZE(values) == 0) {
        PyErr_SetString(PyExc_TypeError, "a row is a tuple of values");
        return NULL;
    }
    if (second_of(PyTuple_GET_ITEM(values, 0), &second) < 0)
        return NULL;
    if (!self->begun || second != self->second || buffer->lines >= LINES_MAX) {
        if (flush(buffer) < 0)
            return NULL;
        self->begun = true;
        self->second = second;
    }
    size_t before = buffer->size;
    for (Py_ssize_t at = 0; at < PyTuple_GET_SIZE(values); at++)
        if ((at && put_character(buffer, ',') < 0) ||
            put_field(self, PyTuple_GET_ITEM(values, at)) < 0) {
            buffer->size = before;
            return NULL;
        }
    if (put_character(buffer, '\n') < 0)
        return NULL;
    buffer->lines++;
    Py_RETURN_NONE;
}

static PyObject *csv_lines_flush(CsvLines *self, PyObject *unused)
{
    return flush(&self->buffer) < 0 ? NULL : Py_NewRef(Py_None);
}

static PyObject *lines_new(PyTypeObject *type, PyObject *args, PyObject *named)
{
    static char *names[] = {"write", NULL};
    PyObject *write;
    if (!PyArg_ParseTupleAndKeywords(args, named, "O", names, &write))
        return NULL;
    CsvLines *self = (CsvLines *)type->tp_alloc(type, 0);
    if (self)
        self->buffer.write = Py_NewRef(write);
    return (PyObject *)self;
}

static void csv_lines_dealloc(PyObject *self)
{
    for (int at = 0; at < ENUMS_KEPT; at++) {
        Py_CLEAR(((CsvLines *)self)->members[at]);
        Py_CLEAR(((CsvLines *)self)->texts[at]);
    }
    lines_dealloc(self);
}

static PyMethodDef csv_lines_methods[] = {
    {"row", (PyCFunction)csv_lines_row, METH_O, NULL},
    {"flush", (PyCFunction)csv_lines_flush, METH_NOARGS, NULL},
    {NULL},
};

static PyTypeObject CsvLinesType = {
    LINES_TYPE(CsvLines, lines_new, csv_lines_dealloc, csv_lines_methods)};

/* Lines of a port log. */
typedef struct {
    PyObject_HEAD
    struct buffer buffer;
} PortLines;

static PyObject *port_lines_text(PortLines *self, PyObject *text)
{
    if (!PyUnicode_Check(text)) {
        PyErr_SetString(PyExc_TypeError, "a line is a text");
        return NULL;
    }
    if (put_text(&self->buffer, text) < 0)
        return NULL;
    self->buffer.lines++;
    Py_RETURN_NONE;
}

/* Write an identifier of at least `width` digits and a blank. */
static char *put_any_identifier(char *to, unsigned long id, int width)
{
    if (width == 3 && id < 0x1000)
        to = put_identifier(to, (unsigned)id);
    else
        to += sprintf(to, "%0*lX", width, id);
    *to++ = ' ';
    return to;
}

static char *put_data(char *to, PyObject *data)
{
    if (!PyBytes_GET_SIZE(data)) {
        *to++ = '-';
        return to;
    }
    return put_hex(to, (uint8_t *)PyBytes_AS_STRING(data), (size_t)PyBytes_GET_SIZE(data));
}

static PyObject *port_lines_sent(PortLines *self, PyObject *args)
{
    unsigned long id;
    PyObject *data;
    if (!PyArg_ParseTuple(args, "kS", &id, &data))
        return NULL;
    char *to = reserve(&self->buffer, 2 * (size_t)PyBytes_GET_SIZE(data) + 64);
    if (!to)
        return NULL;
    memcpy(to, "tx can ", 7);
    to = put_any_identifier(to + 7, id, 3);
    end_line(&self->buffer, put_data(to, data));
    Py_RETURN_NONE;
}

/* Write a received frame; a tuple like CanFrame. */
static int put_received(PortLines *self, PyObject *frame)
{
    if (!PyTuple_Check(frame) || PyTuple_GET_SIZE(frame) != 6)
        return PyErr_Format(PyExc_TypeError, "not a frame: %R", frame), -1;
    int extended = PyObject_IsTrue(PyTuple_GET_ITEM(frame, 3));
    int remote = PyObject_IsTrue(PyTuple_GET_ITEM(frame, 4));
    int error = PyObject_IsTrue(PyTuple_GET_ITEM(frame, 5));
    long long stamp_ns = PyLong_AsLongLong(PyTuple_GET_ITEM(frame, 0));
    unsigned long id = PyLong_AsUnsignedLong(PyTuple_GET_ITEM(frame, 1));
    if (PyErr_Occurred())
        return -1;
    PyObject *data = PyBytes_FromObject(PyTuple_GET_ITEM(frame, 2));
    char *to = data ? reserve(&self->buffer, 2 * (size_t)PyBytes_GET_SIZE(data) + 64) : NULL;
    if (to) {
        memcpy(to, "rx can ", 7);
        to = put_whole(to + 7, stamp_ns);
        *to++ = ' ';
        to = put_any_identifier(to, id, extended || error ? 8 : 3);
        if (error || remote) {
            *to++ = error ? 'E' : 'R';
            *to++ = ':';
        }
        end_line(&self->buffer, put_data(to, data));
    }
    Py_XDECREF(data);
    return to ? 0 : -1;
}

static PyObject *port_lines_received(PortLines *self, PyObject *frames)
{
    PyObject *all = PySequence_Fast(frames, "frames are a sequence");
    if (!all)
        return NULL;
    int failed = 0;
    for (Py_ssize_t at = 0; at < PySequence_Fast_GET_SIZE(all) && !failed; at++)
        failed = put_received(self, PySequence_Fast_GET_ITEM(all, at));
    Py_DECREF(all);
    return failed ? NULL : Py_NewRef(Py_None);
}

static PyObject *port_lines_flush(PortLines *self, PyObject *unused)
{
    return flush(&self->buffer) < 0 ? NULL : Py_NewRef(Py_None);
}

static PyObject *port_lines_waiting(PortLines *self, void *unused)
{
    return PyLong_FromSsize_t(self->buffer.lines);
}

static PyMethodDef port_lines_methods[] = {
    {"text", (PyCFunction)port_lines_text, METH_O, NULL},
    {"sent", (PyCFunction)port_lines_sent, METH_VARARGS, NULL},
    {"received", (PyCFunction)port_lines_received, METH_O, NULL},
    {"flush", (PyCFunction)port_lines_flush, METH_NOARGS, NULL},
    {NULL},
};

static PyGetSetDef port_lines_members[] = {
    {"waiting", (getter)port_lines_waiting, NULL, NULL, NULL},
    {NULL},
};

static PyTypeObject PortLinesType = {
    LINES_TYPE(PortLines, lines_new, lines_dealloc, port_lines_methods),
    .tp_getset = port_lines_members};

#endif
