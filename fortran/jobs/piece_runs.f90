! Optimize: -O1
!> Runs of one motion, for the search of their step: each is a piece from the start to the end.
module viscovib_piece_runs
  use viscovib_between_ends, only: beyond, fill_between
  use viscovib_counters, only: count_up, counted_runs, counting
  use viscovib_driven_system, only: driven_system_type
  use viscovib_fitted_memory, only: shared_error
  use viscovib_histories, only: past_direct
  use viscovib_kinds, only: i8, wp
  use viscovib_march, only: begun, no_exponentials, step_too_large
  use viscovib_mesh, only: mesh_type, new_mesh
  use viscovib_method_catalogue, only: method_order, new_stepper
  use viscovib_motion_piece, only: as_before, from_start, motion_equations, nothing, piece_type, &
    under_other_loads
  use viscovib_motion_request, only: located_from, transient_job
  use viscovib_plain_pieces, only: plain_equations
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type
  use viscovib_stepper, only: stepper_type
  use viscovib_stopping, only: begin_piece
  use viscovib_time_run, only: run_coarse, run_completed, run_diverged, run_event
  use viscovib_trajectory, only: trajectory_type
  use viscovib_watch, only: n_event_rows
  implicit none
  private

  public :: part_type, piece_runs, shared_type

  !> Part of a step for which kernels are fitted if a run stops inside it.
  real(wp), parameter :: fine = 2.0_wp**(-14)
  !> Largest order that runs are trusted to have.
  integer, parameter :: most_order = 16
  !> A lower bound of the gain by a quarter of the step for motions with memory.
  real(wp), parameter :: by_quarter = 2.0_wp
  !> Smallest relative error of the solution of equations.
  real(wp), parameter :: rounding = 1.0e-15_wp

  !> Findings of one run that all runs of a search use.
  type :: shared_type
    logical :: in_parts = .false.
    real(wp) :: longest = 0.0_wp
    integer :: past = 0
    !> Relative tolerance of the equations of first steps of a smooth motion; 0: as given.
    real(wp) :: solved = 0.0_wp
  end type shared_type

  !> A part of a run under loads that acted earlier, and the number of steps at its end.
  type :: part_type
    class(motion_equations), pointer :: equations => null()
    integer(i8) :: until = 0
  end type part_type

  type :: piece_runs
    class(motion_equations), pointer :: equations => null()
    type(shared_type), pointer :: shared => null()
    !> The first run to `t_end`; ends of steps, if they are not equal. A run that continues has
    !! steps before (`first%first`).
    type(piece_type) :: first
    !> Of a run that continues: its parts under other loads than now, its state at time 0, and true
    !! if the data of the steps before are not those that the next steps need.
    type(part_type), allocatable :: earlier(:)
    real(wp), allocatable :: begun(:)
    logical :: remakes = .false.
    logical :: has_mesh = .false.
    type(mesh_type) :: mesh
    real(wp) :: t_end = 0.0_wp
    !> True if a number of steps counts those of the mesh, else equal ones.
    logical :: counts = .false.
    !> States to keep: at given times, the last one, or those of the last `tail`, 0: all;
    !! true if states on the way are kept for comparison.
    logical :: at_times = .false., last_only = .false., looks = .false.
    real(wp) :: tail = 0.0_wp
    !> Rows of states by which runs are compared; true if a changed start keeps its displacements.
    integer, allocatable :: rows(:)
    logical :: holds_places = .false.
    !> Largest number of steps with the whole past if kernels are not sums of exponentials; the
    !! shortest step of a run that continues, 0: none.
    integer(i8) :: most_direct = 0
    real(wp) :: later = 0.0_wp
  contains
    procedure :: begin
    procedure :: make
    procedure :: make_shaken
    procedure :: align
    procedure :: renames
    procedure :: goes_inside
    procedure :: keeps_all
    procedure :: goes_in_parts
    procedure :: is_smooth
    procedure :: gain
    procedure :: fill
  end type piece_runs

  !> One run: its steps and their length, the requested states, its start, and its only or last
  !! piece.
  type :: course_type
    integer(i8) :: steps = 0
    integer :: factor = 1
    real(wp) :: h = 0.0_wp, shortest = 0.0_wp
    real(wp), allocatable :: times(:), start(:)
    type(piece_type) :: piece
    !> The next piece: its equations, the steps before it, how it starts, and its data.
    class(motion_equations), pointer :: equations => null()
    integer(i8) :: made = 0
    integer :: resume = from_start
    real(wp), allocatable :: memory(:)
    integer, allocatable :: sides(:)
    !> Number of the times that belong to the pieces before, and their states and accelerations.
    integer :: n_taken = 0
    real(wp), allocatable :: at_times(:, :), accelerations(:, :)
    !> Steps of that piece without requested states; true if only the state at its end remains.
    integer(i8) :: dropped = 0
    logical :: cut_off = .false.
  end type course_type

contains

  !> Prepare the first run.
  subroutine begin(self, shared)
    class(piece_runs), intent(inout) :: self
    type(shared_type), intent(inout), target :: shared
    self%shared => shared
    call self%first%set_mesh()
    self%mesh = self%first%mesh
    self%has_mesh = self%mesh%is_broken()
    shared%in_parts = self%first%in_parts
    shared%longest = max(shared%longest, self%first%h)
    shared%past = self%first%past
  end subroutine begin

  !> One run in n*factor steps, with `parts` states in each of n steps, and one state per
  !! save_every steps; on a mesh the steps are those of the mesh. `parts` divides the factor, or if
  !! a run `goes_inside` is a multiple of it.
  subroutine make(self, job, n, factor, parts, trajectory, status)
    class(piece_runs), intent(in) :: self
    class(transient_job), intent(in) :: job
    integer(i8), intent(in) :: n
    integer, intent(in) :: factor, parts
    type(trajectory_type), intent(out) :: trajectory
    type(status_type), intent(out) :: status
    type(course_type), target :: course

    call begin_piece()
    if (counting) call count_up(counted_runs, 1)
    call set_ok(status)
    course%factor = factor
    course%steps = (self%first%first + n)*factor
    if (self%has_mesh .and. .not. self%counts) then
      course%steps = self%mesh%made_by(size(self%mesh%made_by))*factor
    end if
    course%h = self%first%h/real(factor, wp)
    if (self%at_times) then
      allocate (course%times, source=self%first%times)
    else
      call times_of(self, job, n, factor, parts, course%times)
    end if
    course%shortest = shortest_step(self, factor)
    trajectory%h = course%h
    do
      call run_once(self, job, n, parts, course, trajectory, status)
      if (status%failed()) return
      if (.not. (self%equations%collocated .and. self%equations%fitted)) exit
      if (self%shared%past == past_direct) exit
      if (course%piece%ended /= run_diverged .and. course%piece%ended /= run_coarse) exit
      if (course%shortest > 0.0_wp .and. course%shortest <= fine*course%h) exit
      if (course%piece%ended == run_coarse .and. course%piece%gives_up) exit
      ! The stop is located by steps for which the exponentials were not fitted.
      course%shortest = fine*course%h
    end do
    trajectory%shortest = course%shortest
    call take(self, course, trajectory)
    if (.not. self%has_mesh) return
    trajectory%ends = self%mesh%ends
    trajectory%made_by = self%mesh%made_by*factor
  end subroutine make

  !> The run from its start; the part without requested states is run first, unless events are
  !! requested.
  subroutine run_once(self, job, n, parts, course, trajectory, status)
    class(piece_runs), intent(in) :: self
    class(transient_job), intent(in) :: job
    integer(i8), intent(in) :: n
    integer, intent(in) :: parts
    type(course_type), intent(inout), target :: course
    type(trajectory_type), intent(inout) :: trajectory
    type(status_type), intent(out) :: status
    real(wp), allocatable :: looks(:, :)
    integer(i8) :: apart, between, skipped

    call begin_course(self, job, course, status)
    if (status%failed() .or. course%cut_off) return
    apart = job%save_every*course%factor
    between = job%steps_between_looks(n)*course%factor
    if (self%has_mesh) between = job%steps_between_looks(course%steps/course%factor)*course%factor
    skipped = 0
    if (self%tail > 0.0_wp .and. size(course%times) == 0) then
      skipped = course%steps - course%made
      skipped = skipped - ceiling(min(self%tail/course%h, real(skipped, wp)), i8)
      skipped = max(skipped, 0_i8)/apart*apart
    end if
    course%dropped = 0
    if (self%first%is_watched) course%dropped = skipped
    if (skipped > course%dropped) then
      call go(self, job, course, skipped, between, status)
      if (status%failed()) return
      allocate (looks, source=states_of(course%piece))
      ! The requested states are after a stop: only the state there exists.
      course%cut_off = course%piece%ended /= run_completed
      if (.not. course%cut_off) call carry_on(course)
    end if
    if (.not. course%cut_off) then
      apart = max(job%save_every*(course%factor/parts), 1)
      if (self%last_only .or. size(course%times) > 0) then
        apart = merge(between, course%steps + 1, self%looks)
      end if
      call go(self, job, course, course%steps - course%made, apart, status)
      if (status%failed()) return
      if (course%piece%ended == run_completed) course%piece%t_reached = self%t_end
    end if
    if (.not. self%looks) return
    if (.not. allocated(looks)) allocate (looks, source=states_of(course%piece))
    if (allocated(trajectory%looks)) deallocate (trajectory%looks)
    allocate (trajectory%looks(size(self%first%initial), size(looks, 2) + 1))
    trajectory%looks(:, 1) = self%first%initial
    trajectory%looks(:, 2:) = looks
  end subroutine run_once

  !> States that a piece has kept.
  pure function states_of(piece) result(states)
    type(piece_type), intent(in) :: piece
    real(wp), allocatable :: states(:, :)
    integer :: kept
    kept = int(min(piece%n_done/piece%save_every, size(piece%states, 2, i8)))
    allocate (states, source=piece%states(:, :kept))
  end function states_of

  !> The shortest step of a run, 0: all are equal, and it ends with them.
  pure real(wp) function shortest_step(self, factor) result(shortest)
    class(piece_runs), intent(in) :: self
    integer, intent(in) :: factor
    real(wp) :: needed
    associate (first => self%first)
      shortest = first%shortest
      if (first%first == 0 .or. first%resume == from_start) then
        if (self%later > 0.0_wp) shortest = min(minval(self%mesh%h)/factor, self%later)
        return
      end if
      needed = first%h
      if (self%has_mesh) needed = min(minval(self%mesh%h), self%later)
      if (first%resume == under_other_loads .or. self%has_mesh) then
        if (shortest > 0.0_wp) needed = min(needed, shortest)
        shortest = needed
      end if
      shortest = shortest/factor
    end associate
  end function shortest_step

  !> Begin a run: from its start, from the data of its steps before, or if these do not serve, by
  !! making its earlier parts again.
  subroutine begin_course(self, job, course, status)
    class(piece_runs), intent(in) :: self
    class(transient_job), intent(in) :: job
    type(course_type), intent(inout), target :: course
    type(status_type), intent(out) :: status
    logical :: goes_on

    call set_ok(status)
    course%cut_off = .false.
    course%made = 0
    course%resume = from_start
    course%n_taken = 0
    if (allocated(course%at_times)) deallocate (course%at_times)
    if (allocated(course%accelerations)) deallocate (course%accelerations)
    if (allocated(course%sides)) deallocate (course%sides)
    if (allocated(self%first%sides)) course%sides = self%first%sides
    course%equations => self%equations
    goes_on = .true.
    if (self%first%first > 0) goes_on = data_serve(self, course)
    if (goes_on) then
      course%start = self%first%initial
      course%made = self%first%first
      course%resume = self%first%resume
      if (course%resume /= from_start) course%memory = self%first%memory
    else
      course%start = self%begun
    end if
    if (self%first%sign /= 0) call shake(self, course%start)
    if (.not. goes_on) call make_earlier(self, job, course, status)
  end subroutine begin_course

  !> True if a run may continue from the data of its steps before: it has their steps, and kernels
  !! are not fitted for longer ones.
  logical function data_serve(self, course)
    class(piece_runs), intent(in) :: self
    type(course_type), intent(inout) :: course
    data_serve = .false.
    associate (first => self%first)
      if (first%resume == from_start .or. course%factor > 1 .or. first%sign /= 0) return
      if (self%remakes) return
      data_serve = .true.
      if (self%shared%past == past_direct) return
      if (.not. (self%equations%collocated .and. self%equations%fitted)) return
      data_serve = course%shortest >= first%shortest*(1.0_wp - 1.0e-9_wp)
      if (.not. first%shortest > 0.0_wp) data_serve = .not. (course%shortest > 0.0_wp)
      if (data_serve) course%shortest = first%shortest
    end associate
  end function data_serve

  !> Make the parts of a run before its next piece, without keeping states but those at the times.
  subroutine make_earlier(self, job, course, status)
    class(piece_runs), intent(in) :: self
    class(transient_job), intent(in) :: job
    type(course_type), intent(inout), target :: course
    type(status_type), intent(out) :: status
    integer(i8) :: until
    integer :: i, n

    call set_ok(status)
    n = 0
    if (allocated(self%earlier)) n = size(self%earlier)
    do i = 1, n + 1
      until = self%first%first*course%factor
      if (i <= n) then
        until = self%earlier(i)%until*course%factor
        course%equations => self%earlier(i)%equations
      else
        course%equations => self%equations
        if (n > 0) then
          ! Data of other equations do not serve.
          if (.not. same_type_as(self%equations, self%earlier(n)%equations)) then
            course%memory = nothing
          end if
        end if
      end if
      if (i > 1) course%resume = under_other_loads
      if (until <= course%made) cycle
      call go(self, job, course, until - course%made, course%steps + 1, status)
      if (status%failed()) return
      course%cut_off = course%piece%ended /= run_completed
      if (course%cut_off) return
      call collect(course)
      call carry_on(course)
    end do
  end subroutine make_earlier

  !> Add the states at times of a piece that is not the last one.
  subroutine collect(course)
    type(course_type), intent(inout) :: course
    associate (piece => course%piece)
      course%n_taken = course%n_taken + size(piece%times)
      call append(course%at_times, piece%at_times(:, :piece%n_reached))
      if (allocated(piece%accelerations)) then
        call append(course%accelerations, piece%accelerations(:, :piece%n_reached))
      end if
    end associate
  end subroutine collect

  subroutine append(columns, more)
    real(wp), allocatable, intent(inout) :: columns(:, :)
    real(wp), intent(in) :: more(:, :)
    real(wp), allocatable :: both(:, :)
    integer :: n
    n = 0
    if (allocated(columns)) n = size(columns, 2)
    allocate (both(size(more, 1), n + size(more, 2)))
    if (n > 0) both(:, :n) = columns
    both(:, n + 1:) = more
    call move_alloc(both, columns)
  end subroutine append

  !> Let the next piece continue the last one.
  subroutine carry_on(course)
    type(course_type), intent(inout) :: course
    integer :: n_events, n_found
    real(wp) :: none(n_event_rows, 0)
    associate (piece => course%piece)
      course%made = piece%first + piece%n_done
      course%resume = as_before
      course%start = piece%last
      course%memory = piece%kept
      if (.not. allocated(piece%watch)) return
      n_events = size(piece%watch%sides)
      if (.not. allocated(course%sides)) allocate (course%sides(3*n_events))
      call piece%watch%hand_over(course%sides, none, n_found)
      course%sides(2*n_events + 1:) = 0
    end associate
  end subroutine carry_on

  !> Make `count` steps of the next piece, and keep every `apart`-th state.
  subroutine go(self, job, course, count, apart, status)
    class(piece_runs), intent(in) :: self
    class(transient_job), intent(in) :: job
    type(course_type), intent(inout), target :: course
    integer(i8), intent(in) :: count, apart
    type(status_type), intent(out) :: status
    do
      course%piece = self%first
      associate (piece => course%piece)
        piece%first = course%made
        piece%resume = course%resume
        piece%memory => nothing
        if (course%resume /= from_start) piece%memory => course%memory
        if (allocated(course%sides)) piece%sides = course%sides
        ! In a search, steps that are too large become shorter anyway.
        piece%gives_up = job%dt <= 0.0_wp .and. course%factor < located_from
        piece%n_steps = count
        piece%save_every = apart
        piece%h = course%h
        piece%factor = course%factor
        piece%shortest = course%shortest
        piece%past = self%shared%past
        piece%in_parts = self%shared%in_parts
        piece%thin = course%h/max(self%shared%longest, course%h)
        if (self%equations%collocated) then
          piece%tolerance = max(self%first%tolerance/real(course%factor, wp)**2, rounding)
        else if (self%shared%solved > 0.0_wp) then
          ! Far less than 1/gain for half the step: a number of iterations is not continuous, and
          ! unstable motions amplify the error of the solution.
          piece%tolerance = max(self%shared%solved/real(course%factor, wp)**12, rounding)
        end if
        piece%initial => course%start
        call take_times(course, course%made + count >= course%steps)
        call piece%allocate_arrays(int(count/apart))
        call course%equations%run(piece, status)
        if (status%failed()) return
        if (piece%reason == begun) exit
        if (piece%reason == step_too_large) then
          piece%ended = run_coarse
          piece%n_done = 0
          piece%t_reached = piece%mesh%start_of(piece%first)
          piece%last = course%start
          exit
        end if
        call turn_direct(self, piece%reason, course%steps, status)
        if (status%failed()) return
      end associate
    end do
    self%shared%in_parts = self%shared%in_parts .or. course%piece%in_parts
  end subroutine go

  !> The times within the next piece; the last piece has all that are left.
  subroutine take_times(course, is_last)
    type(course_type), intent(inout) :: course
    logical, intent(in) :: is_last
    integer :: last
    last = size(course%times)
    associate (piece => course%piece)
      if (last > course%n_taken .and. .not. is_last) then
        call piece%set_mesh()
        last = count(course%times < piece%mesh%start_of(piece%first + piece%n_steps))
      end if
      piece%times = course%times(course%n_taken + 1:last)
    end associate
  end subroutine take_times

  !> Store the whole past if kernels are no sums of exponentials, or fail if that is too much.
  subroutine turn_direct(self, reason, steps, status)
    class(piece_runs), intent(in) :: self
    integer, intent(in) :: reason
    integer(i8), intent(in) :: steps
    type(status_type), intent(out) :: status
    call set_ok(status)
    if (reason /= no_exponentials) then
      call fail(status, status_input_error, 'held', 'held: must be None, because a kernel has no ' &
                //'finite integral: a deflection held for all t < 0 has no force')
    else if (self%most_direct == 0) then
      call fail(status, status_input_error, 'memory', 'memory = "exponentials": a kernel is not ' &
                //'a sum of exponentials (tables of points never are); must be "direct" or "auto"')
    else if (steps > self%most_direct) then
      call fail(status, status_input_error, 'memory', 'memory = "auto": a kernel is not a sum ' &
                //'of exponentials, and '//show(int(steps))//' steps with the whole history are ' &
                //'more than '//show(int(self%most_direct))//'; use memory="direct", or fit the ' &
                //'kernel by sum_of_exponentials')
    else
      self%shared%past = past_direct
    end if
  end subroutine turn_direct

  !> Times of kept states that are not ends of equal steps; empty if they are.
  subroutine times_of(self, job, n, factor, parts, times)
    class(piece_runs), intent(in) :: self
    class(transient_job), intent(in) :: job
    integer(i8), intent(in) :: n
    integer, intent(in) :: factor, parts
    real(wp), allocatable, intent(out) :: times(:)
    type(mesh_type) :: mesh
    integer(i8) :: count, i, k

    if (self%last_only .or. .not. (self%has_mesh .or. parts > factor)) then
      allocate (times(0))
      return
    end if
    if (.not. self%has_mesh) then
      allocate (times(n*parts + 1))
      do i = 0, n*parts
        times(i + 1) = real(i, wp)*(self%t_end/real(n*parts, wp))
      end do
      times(n*parts + 1) = self%t_end
      return
    end if
    call new_mesh(mesh, self%first%h/real(parts, wp), self%mesh%ends, self%mesh%made_by*parts)
    count = mesh%made_by(size(mesh%made_by))
    allocate (times(count/job%save_every + 1))
    do i = 1, size(times)
      k = (i - 1)*job%save_every
      times(i) = mesh%start_of(k)
    end do
    if (self%tail > 0.0_wp) then
      times = pack(times, times >= times(size(times)) - self%tail*(1.0_wp + 1.0e-12_wp))
    end if
  end subroutine times_of

  !> Copy the results of the only or last piece of a run.
  subroutine take(self, course, trajectory)
    class(piece_runs), intent(in) :: self
    type(course_type), intent(inout), target :: course
    type(trajectory_type), intent(inout) :: trajectory
    real(wp), allocatable :: states(:, :), kept(:, :)
    integer :: i, n

    associate (piece => course%piece)
      trajectory%outcome = piece%ended
      trajectory%n_steps = piece%first + piece%n_done
      trajectory%t_reached = piece%t_reached
      trajectory%last = piece%last
      if (piece%ended == run_event .and. allocated(piece%watch)) then
        n = size(piece%last)
        trajectory%last = piece%watch%states(:n, piece%watch%n_found)
      end if
      if (size(course%times) > 0 .and. .not. course%cut_off) then
        if (allocated(course%at_times)) then
          call collect(course)
          call move_alloc(course%at_times, states)
          if (allocated(course%accelerations)) then
            call move_alloc(course%accelerations, piece%accelerations)
          end if
        else if (piece%n_reached == size(piece%at_times, 2)) then
          call move_alloc(piece%at_times, states)
        else
          states = piece%at_times(:, :piece%n_reached)
        end if
        trajectory%t = course%times(:size(states, 2))
      else if (self%last_only .or. course%cut_off) then
        states = reshape(trajectory%last, [size(piece%last), 1])
        trajectory%t = [piece%t_reached]
      else
        allocate (kept, source=states_of(piece))
        n = size(kept, 2)
        allocate (states(size(piece%last), n + 1), trajectory%t(n + 1))
        states(:, 1) = course%start
        states(:, 2:) = kept
        trajectory%t = [(real(piece%first + i*piece%save_every, wp)*course%h, i=0, n)]
        ! The product is rounded.
        if (piece%ended == run_completed .and. n*piece%save_every == piece%n_done) then
          trajectory%t(n + 1) = self%t_end
        end if
        if (course%dropped > 0) then
          i = int(min(course%dropped/piece%save_every, int(n, i8)))
          trajectory%t = trajectory%t(i + 1:)
          states = states(:, i + 1:)
        end if
      end if
      if (size(self%rows) < size(states, 1)) then
        trajectory%rows = self%rows
        trajectory%states = states(self%rows, :)
        if (allocated(trajectory%looks)) trajectory%looks = trajectory%looks(self%rows, :)
        call move_alloc(states, trajectory%whole)
      else
        call move_alloc(states, trajectory%states)
      end if
      trajectory%too_long = piece%too_long
      trajectory%resolution = piece%resolution
      trajectory%counted = piece%counted
      if (allocated(piece%phased)) trajectory%by_phases = maxval(piece%phased(self%rows))
      if (allocated(piece%kept)) call move_alloc(piece%kept, trajectory%memory)
      if (allocated(piece%kinds)) call move_alloc(piece%kinds, trajectory%kinds)
      if (allocated(piece%watch)) call move_alloc(piece%watch, trajectory%watch)
      if (allocated(piece%accelerations)) then
        call move_alloc(piece%accelerations, trajectory%accelerations)
      end if
    end associate
    associate (equations => self%equations)
      trajectory%keeps_energy = equations%keeps_energy
      trajectory%over_kinks = equations%over_kinks
      trajectory%solved = course%piece%tolerance
      if (equations%fitted .and. .not. equations%collocated) trajectory%represented = shared_error
    end associate
  end subroutine take

  !> Change the start by `shaken`.
  subroutine shake(self, start)
    class(piece_runs), intent(in) :: self
    real(wp), intent(inout) :: start(:)
    real(wp) :: times
    times = 1.0_wp + self%first%sign*self%equations%change
    if (.not. self%holds_places) start(1::2) = times*start(1::2)
    start(2::2) = times*start(2::2)
  end subroutine shake

  subroutine make_shaken(self, job, n, factor, sign, trajectory, status)
    class(piece_runs), intent(in) :: self
    class(transient_job), intent(in) :: job
    integer(i8), intent(in) :: n
    integer, intent(in) :: factor, sign
    type(trajectory_type), intent(out) :: trajectory
    type(status_type), intent(out) :: status
    type(piece_runs) :: other
    call set_ok(status)
    if (self%shared%in_parts) return
    select type (self)
    type is (piece_runs)
      other = self
    end select
    other%first%sign = sign
    call other%make(job, n, factor, 1, trajectory, status)
  end subroutine make_shaken

  !> True if the states have equivalent forms, as for a body with large rotations.
  logical function renames(self)
    class(piece_runs), intent(in) :: self
    renames = associated(self%equations%turning)
  end function renames

  !> Use the nearest equivalent rotation vector for bodies with large rotations.
  subroutine align(self, run, like)
    class(piece_runs), intent(in) :: self
    type(trajectory_type), intent(inout) :: run, like
    real(wp) :: u(size(run%states, 1)/2), v(size(run%states, 1)/2)
    logical :: renamed
    integer :: i

    if (.not. self%renames()) return
    do i = 1, min(size(run%states, 2), size(like%states, 2))
      u = run%states(1::2, i)
      v = run%states(2::2, i)
      call self%equations%turning%rename_state(u, v, renamed, like%states(1::2, i))
      if (.not. renamed) cycle
      run%states(1::2, i) = u
      run%states(2::2, i) = v
    end do
  end subroutine align

  logical function goes_inside(self)
    class(piece_runs), intent(in) :: self
    goes_inside = self%equations%collocated
  end function goes_inside

  !> True for smooth motions, of which half the step has far less than 1/`gain` of the error.
  pure logical function is_smooth(self)
    class(piece_runs), intent(in) :: self
    is_smooth = self%gain() > 1.0_wp
  end function is_smooth

  !> A lower bound of the gain in accuracy by halving the step so often (default: once); 1: not
  !! known.
  pure real(wp) function gain(self, halvings)
    class(piece_runs), intent(in) :: self
    integer, intent(in), optional :: halvings
    integer :: order, n
    gain = 1.0_wp
    n = 1
    if (present(halvings)) n = halvings
    ! Errors of events are differences of runs.
    if (self%has_mesh .or. self%first%is_watched) return
    select type (equations => self%equations)
    class is (plain_equations)
      order = min(method_order(equations%method), most_order)
      if (equations%are_smooth()) gain = 2.0_wp**(n*(order/2 - 2))
    class default
      if (n > 1 .and. .not. equations%over_kinks) gain = by_quarter
    end select
  end function gain

  !> Add states of a smooth motion between the ends of its steps, `per` for each step.
  subroutine fill(self, run, per, allowed, filled, off, status)
    class(piece_runs), intent(in) :: self
    !> With the ends of all steps.
    type(trajectory_type), intent(in) :: run
    integer, intent(in) :: per
    !> Allowed error of each row of states.
    real(wp), intent(in) :: allowed(:)
    type(trajectory_type), intent(out) :: filled
    !> Error of each row; larger than allowed: the states are not computed.
    real(wp), intent(out) :: off(:)
    type(status_type), intent(out) :: status
    class(driven_system_type), allocatable :: rates
    real(wp), allocatable :: states(:, :)
    integer :: i, n
    logical :: made

    call set_ok(status)
    off = huge(1.0_wp)
    n = size(run%t) - 1
    allocate (states(size(run%states, 1), -beyond:n + beyond))
    states(:, 0:n) = run%states
    select type (equations => self%equations)
    class is (plain_equations)
      call equations%find_rates(run%h, rates, status)
      if (status%failed() .or. .not. allocated(rates)) return
      if (rates%base_motion%moves()) return
      call continue_steps(rates, equations%method, n, run%h, run%solved, states, made)
      if (made) call continue_steps(rates, equations%method, 0, -run%h, run%solved, states, made)
      if (.not. made) return
    end select
    filled = run
    deallocate (filled%states, filled%t)
    allocate (filled%states(size(run%states, 1), n*per + 1), filled%t(n*per + 1))
    do i = 0, n*per
      filled%t(i + 1) = i*(self%t_end/(n*per))
    end do
    filled%t(n*per + 1) = self%t_end
    call fill_between(rates, run%h, states, per, allowed, filled%states, off)
  end subroutine fill

  !> Steps beyond an end of a run: forwards from its end, or backwards (h < 0) from its start.
  subroutine continue_steps(rates, method, from, h, solved, states, made)
    class(driven_system_type), intent(in) :: rates
    !> Index in `transient_methods`, and number of the step at whose end they begin.
    integer, intent(in) :: method, from
    real(wp), intent(in) :: h, solved
    !> States at the ends of steps, the first one at time 0.
    real(wp), intent(inout) :: states(:, -beyond:)
    !> True if the motion exists there.
    logical, intent(out) :: made
    class(stepper_type), allocatable :: stepper
    integer :: at, i

    call new_stepper(stepper, rates, method, states(1::2, from), states(2::2, from), &
                     from*abs(h), h, solved)
    do i = 1, beyond
      call stepper%step(rates, made)
      if (made) made = rates%physical(stepper%q)
      if (.not. made) return
      at = from + nint(sign(real(i, wp), h))
      states(1::2, at) = stepper%q
      states(2::2, at) = stepper%v
    end do
  end subroutine continue_steps

  logical function keeps_all(self)
    class(piece_runs), intent(in) :: self
    keeps_all = self%shared%past == past_direct
  end function keeps_all

  logical function goes_in_parts(self)
    class(piece_runs), intent(in) :: self
    goes_in_parts = self%shared%in_parts
  end function goes_in_parts

end module viscovib_piece_runs
