-- Tables of a data folder of 2026-11-23.
CREATE TABLE alembic_version (version_num VARCHAR(32) NOT NULL, CONSTRAINT alembic_version_pkc PRIMARY KEY (version_num));
CREATE TABLE tokens (id VARCHAR NOT NULL, user VARCHAR NOT NULL, scope VARCHAR NOT NULL, hash VARCHAR NOT NULL, created VARCHAR NOT NULL, expires VARCHAR NOT NULL, revoked VARCHAR, PRIMARY KEY (id), CONSTRAINT uq_tokens_hash UNIQUE (hash));
CREATE TABLE rig_versions (id VARCHAR NOT NULL, name VARCHAR NOT NULL, hash VARCHAR NOT NULL, text VARCHAR NOT NULL, created VARCHAR NOT NULL, user VARCHAR NOT NULL, PRIMARY KEY (id), CONSTRAINT uq_rig_versions_hash UNIQUE (hash));
CREATE INDEX ix_rig_versions_name ON rig_versions (name);
CREATE TABLE sessions (id VARCHAR NOT NULL, rig_id VARCHAR NOT NULL, source VARCHAR NOT NULL, state VARCHAR NOT NULL, created VARCHAR NOT NULL, user VARCHAR NOT NULL, n_readings INTEGER, hash VARCHAR, PRIMARY KEY (id), CONSTRAINT fk_sessions_rig_id FOREIGN KEY(rig_id) REFERENCES rig_versions (id));
CREATE INDEX ix_sessions_rig_id ON sessions (rig_id);
CREATE INDEX ix_sessions_hash ON sessions (hash);
CREATE TABLE jobs (number INTEGER NOT NULL, id VARCHAR NOT NULL, user VARCHAR NOT NULL, kind VARCHAR NOT NULL, state VARCHAR NOT NULL, session_id VARCHAR NOT NULL, rig_id VARCHAR, options JSON NOT NULL, idempotency_key VARCHAR, created VARCHAR NOT NULL, started VARCHAR, ended VARCHAR, starts INTEGER NOT NULL, fault VARCHAR, PRIMARY KEY (number), CONSTRAINT uq_jobs_id UNIQUE (id), CONSTRAINT uq_jobs_key UNIQUE (user, idempotency_key), CONSTRAINT fk_jobs_session_id FOREIGN KEY(session_id) REFERENCES sessions (id), CONSTRAINT fk_jobs_rig_id FOREIGN KEY(rig_id) REFERENCES rig_versions (id));
CREATE INDEX ix_jobs_user ON jobs (user);
CREATE INDEX ix_jobs_session_id ON jobs (session_id);
CREATE INDEX ix_jobs_queue ON jobs (state, number);
CREATE TABLE calibrations (id VARCHAR NOT NULL, job_id VARCHAR NOT NULL, session_id VARCHAR NOT NULL, rig_name VARCHAR NOT NULL, created VARCHAR NOT NULL, user VARCHAR NOT NULL, PRIMARY KEY (id), CONSTRAINT uq_calibrations_job_id UNIQUE (job_id), CONSTRAINT fk_calibrations_job_id FOREIGN KEY(job_id) REFERENCES jobs (id), CONSTRAINT fk_calibrations_session_id FOREIGN KEY(session_id) REFERENCES sessions (id));
CREATE INDEX ix_calibrations_session_id ON calibrations (session_id);
CREATE INDEX ix_calibrations_rig_name ON calibrations (rig_name);
CREATE TABLE audit (number INTEGER NOT NULL, time VARCHAR NOT NULL, user VARCHAR NOT NULL, token_id VARCHAR, request_id VARCHAR NOT NULL, action VARCHAR NOT NULL, target VARCHAR NOT NULL, PRIMARY KEY (number));
CREATE INDEX ix_audit_time ON audit (time);
INSERT INTO alembic_version VALUES ('0001');
