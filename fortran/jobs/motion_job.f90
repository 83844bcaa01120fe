!> A motion in time of any system, with its spectra, its shock response spectrum and the decaying
!! oscillations in it.
module viscovib_motion_job
  use viscovib_aliased_share, only: aliased_share, is_aliased
  use viscovib_amplitude_spectrum, only: amplitude_spectrum
  use viscovib_constants, only: pi
  use viscovib_counters, only: count_up, counted_columns, counting
  use viscovib_fourier, only: check_length
  use viscovib_free_decay, only: decay_type, find_free_decay
  use viscovib_hereditary_job, only: hereditary_job, plan_hereditary
  use viscovib_job, only: job_report, job_type, plan_unwanted, table_sink, error_text
  use viscovib_kinds, only: wp
  use viscovib_law_program, only: wall
  use viscovib_law_term, only: law_term
  use viscovib_motion_quantities, only: find_peaks, find_quantities, motion_quantities, of_point, &
    put_peaks, quantity_length
  use viscovib_number_text, only: exact
  use viscovib_pendulum_job, only: plan_pendulum
  use viscovib_polar, only: argument, modulus
  use viscovib_polynomial_job, only: plan_polynomial
  use viscovib_rounded, only: error_digits, six_digits
  use viscovib_shock_spectrum_job, only: shock_spectrum_job
  use viscovib_status, only: set_ok, show, status_type, things
  use viscovib_structure_job, only: plan_structure
  use viscovib_subject, only: subject_type
  use viscovib_subject_motion, only: method_of, move_subject
  use viscovib_table, only: listed_units, table_type
  use viscovib_time_run, only: run_coarse, run_completed, run_diverged, run_event, run_names
  use viscovib_transient_job, only: trajectory_type, transient_job
  use viscovib_watch, only: coordinates_read
  use viscovib_windows, only: window_hann, window_names
  implicit none
  private

  public :: decay_job, motion_job, spectrum_job, event_text

  !> Number of sample points on the way, and of bisections.
  integer, parameter :: n_places = 41, halvings = 40

  !> Options of &spectrum.
  type :: spectrum_job
    logical :: wanted = .false.
    !> Index in `window_names`.
    integer :: window = window_hann
    !> States before this time are left out.
    real(wp) :: discard = 0.0_wp
    !> Coordinates with a spectrum.
    integer, allocatable :: transformed(:)
  end type spectrum_job

  !> Options of &free_decay.
  type :: decay_job
    logical :: wanted = .false.
    !> Number of oscillations.
    integer :: count = 2
    !> States before this time are left out.
    real(wp) :: start = 0.0_wp
    !> Coordinates to which the oscillations are fitted.
    integer, allocatable :: fitted(:)
  end type decay_job

  !> An event: its function, and "up", "down" or "any", and "terminal" if the run ends there.
  type :: event_text
    character(len=:), allocatable :: text
  end type event_text

  type, extends(job_type) :: motion_job
    !> A `hereditary_job` for a system with memory.
    class(transient_job), allocatable :: motion
    !> Frequency of the load of a system without memory (rad/s).
    real(wp) :: nu = 0.0_wp
    type(spectrum_job) :: spectrum
    type(decay_job) :: decay
    type(shock_spectrum_job) :: shock
    !> Events as given, one per line; not allocated: none.
    type(event_text), allocatable :: events(:)
  contains
    procedure :: plan => plan_motion
    procedure :: run
  end type motion_job

contains

  subroutine plan_motion(self, subject, text, status)
    class(motion_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    character(len=:), allocatable, intent(out) :: text
    type(status_type), intent(out) :: status
    integer :: i

    call set_ok(status)
    associate (motion => self%motion)
      select type (motion)
      type is (hereditary_job)
        if (subject%is_structure) then
          text = subject%description()//plan_structure(motion, subject%structure, &
                                                       subject%model%load)
        else
          text = plan_hereditary(motion, subject%oscillator(), subject%load)
        end if
      type is (transient_job)
        if (subject%is_pendulum) then
          text = plan_pendulum(motion, subject%pendulum)
        else
          text = plan_polynomial(motion, subject%polynomial, subject%load)
        end if
      end select
    end associate
    text = text//plan_unwanted('columns', subject, self%wanted)
    if (self%motion%wants_accelerations) then
      text = text//'computes: accelerations of the states kept, by the equations'//new_line('a')
    end if
    if (allocated(self%motion%point)) text = text//'computes: motion of a point'//new_line('a')
    if (self%motion%wants_forces) text = text//'computes: forces of ' &
      //trim(merge('the mounts          ', 'elements and springs', subject%is_body)) &
      //new_line('a')
    if (self%motion%wants_peaks) text = text//'computes: peaks between the states kept' &
                                        //new_line('a')
    if (allocated(self%events)) text = text//'computes: times of ' &
                                       //things(size(self%events), 'event')//new_line('a')
    if (self%decay%wanted) text = text//'computes: '//things(self%decay%count, &
      'decaying oscillation')//' of the motion from t = '//show(self%decay%start)//new_line('a') &
      //plan_unwanted('a fit', subject, self%decay%fitted)
    if (self%shock%wanted) text = text//self%shock%plan(subject%coordinates)
    if (.not. self%spectrum%wanted) then
      text = text//'skips: Fourier transforms (no spectrum requested)'//new_line('a')
      return
    end if
    associate (transformed => self%spectrum%transformed)
      text = text//'computes: spectra of '//trim(subject%coordinates(transformed(1)))
      do i = 2, size(transformed)
        text = text//', '//trim(subject%coordinates(transformed(i)))
      end do
      text = text//', window '//trim(window_names(self%spectrum%window))//new_line('a') &
             //plan_unwanted('Fourier transforms', subject, transformed)
    end associate
  end subroutine plan_motion

  subroutine run(self, subject, sink, report, status)
    class(motion_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    class(table_sink), intent(inout) :: sink
    type(job_report), intent(out) :: report
    type(status_type), intent(out) :: status
    type(trajectory_type), target :: trajectory
    character(len=:), allocatable :: doubts, folded, method
    type(motion_quantities), target :: quantities
    character(len=quantity_length), allocatable :: names(:)
    real(wp), allocatable :: shares(:), peaks(:, :)
    integer :: i, kept

    method = method_of(self%motion)
    call move_subject(self%motion, subject, self%nu, places(self), trajectory, status)
    if (status%failed()) return
    kept = 2
    if (self%spectrum%wanted) then
      kept = count(trajectory%t >= self%spectrum%discard*(1.0_wp - 1.0e-12_wp))
      call check_length(kept, status)
      if (status%failed()) return
      if (kept >= 2) then
        shares = aliased_shares(self%spectrum, trajectory, kept)
        call put_spectrum(self%spectrum, subject, trajectory, kept, shares, sink, status)
        if (status%failed()) return
      end if
    end if
    call find_quantities(self%motion, subject, self%nu, self%motion%wants_accelerations &
                         .or. self%shock%place > 0, trajectory, quantities, status)
    if (status%failed()) return
    call put_motion(self, subject, trajectory, quantities, method, sink, status)
    if (status%failed()) return
    if (self%motion%wants_forces) call quantities%forces%put(subject, trajectory%t, sink, status)
    if (status%failed()) return
    if (self%motion%wants_peaks) then
      call find_peaks(self%motion, subject, self%nu, self%wanted, trajectory, quantities, names, &
                      peaks, status)
      if (status%failed()) return
      call put_peaks(names, [(i, i=1, size(names))], peaks, sink, status)
      if (status%failed()) return
    end if
    if (allocated(self%events)) call put_events(self, subject, trajectory, sink, status)
    if (status%failed()) return
    if (self%decay%wanted) call put_decay(self%decay, subject, trajectory, sink, folded, status)
    if (status%failed()) return
    doubts = ''
    if (self%shock%wanted) call self%shock%put(trajectory%t, quantities%accelerations, &
                                             sink, doubts, status)
    if (status%failed()) return
    report%complete = any(trajectory%outcome == [run_completed, run_event]) .and. kept >= 2
    report%summary = trim(run_names(trajectory%outcome))//' at t = '//show(trajectory%t_reached) &
                     //', '//things(size(trajectory%t), 'state')
    if (any(trajectory%outcome == [run_diverged, run_coarse])) then
      report%summary = report%summary//law_end(self, subject, trajectory)
    end if
    if (allocated(self%events)) report%summary = report%summary//undefined_events(self, trajectory)
    if (trajectory%error >= 0.0_wp) report%summary = report%summary//', estimated error ' &
                                                     //error_digits(trajectory%error)
    if (kept < 2) report%summary = report%summary//'; no spectrum: ' &
                                   //things(kept, 'state')//' from discard on, must be at least 2'
    if (self%decay%wanted) then
      report%complete = report%complete .and. folded == ''
      report%summary = report%summary//', '//things(self%decay%count, 'decaying oscillation') &
                       //folded
    end if
    report%summary = report%summary//after_semicolons(doubts)
    if (self%spectrum%wanted .and. kept >= 2) then
      folded = aliases(self%spectrum, subject, trajectory, kept, shares)
      report%complete = report%complete .and. folded == ''
      report%summary = report%summary//folded
    end if
  end subroutine run

  !> Lines as parts of a sentence.
  function after_semicolons(lines) result(text)
    character(len=*), intent(in) :: lines
    character(len=:), allocatable :: text
    integer :: first, last
    text = ''
    first = 1
    do while (first <= len(lines))
      last = first + index(lines(first:), new_line('a')) - 2
      text = text//'; '//lines(first:last)
      first = last + 2
    end do
  end function after_semicolons

  !> Part of each coordinate above the Nyquist frequency of the last `kept` states, by its velocity.
  function aliased_shares(self, trajectory, kept) result(shares)
    type(spectrum_job), intent(in) :: self
    type(trajectory_type), intent(in) :: trajectory
    integer, intent(in) :: kept
    real(wp) :: shares(size(self%transformed))
    integer :: first, i, row

    first = size(trajectory%t) - kept + 1
    do i = 1, size(shares)
      row = trajectory%row_of(self%transformed(i))
      shares(i) = aliased_share(trajectory%states(row, first:), &
                                trajectory%states(row + 1, first:), &
                                trajectory%t(2) - trajectory%t(1))
    end do
  end function aliased_shares

  !> Coordinates with components above the Nyquist frequency of the last `kept` states.
  function aliases(self, subject, trajectory, kept, shares) result(text)
    type(spectrum_job), intent(in) :: self
    type(subject_type), intent(in) :: subject
    type(trajectory_type), intent(in) :: trajectory
    integer, intent(in) :: kept
    real(wp), intent(in) :: shares(:)
    character(len=:), allocatable :: text
    real(wp) :: step
    integer :: i

    text = ''
    step = trajectory%t(2) - trajectory%t(1)
    do i = 1, size(shares)
      if (.not. is_aliased(shares(i), kept)) cycle
      text = text//'; states '//show(step)//' apart are too far for the spectrum of ' &
             //trim(subject%coordinates(self%transformed(i)))//': by its velocity ' &
             //show(nint(100.0_wp*min(shares(i), 1.0_wp)))//' % of it swings at more than ' &
             //show(pi/step)//' rad a unit of time, which appear at other frequencies'
    end do
  end function aliases

  !> Events that could not be found: their functions have no value on the way, or change
  !! too fast.
  function undefined_events(self, trajectory) result(text)
    class(motion_job), intent(in) :: self
    type(trajectory_type), intent(in) :: trajectory
    character(len=:), allocatable :: text
    integer :: i
    text = ''
    do i = 1, size(self%events)
      if (trajectory%watch%lost(i) > 0) text = text//'; event '//show(i)//' (' &
        //self%events(i)%text//') changes too fast in '//things(trajectory%watch%lost(i), 'step') &
        //' to find all events, some may be missing'
      if (trajectory%watch%largest(i) > 0.0_wp .or. trajectory%n_steps == 0) cycle
      text = text//'; event '//show(i)//' ('//self%events(i)%text//') has no value on the way'
    end do
  end function undefined_events

  !> The position at which a law ends, if the motion stopped there.
  function law_end(self, subject, trajectory) result(text)
    class(motion_job), intent(in) :: self
    type(subject_type), intent(in) :: subject
    type(trajectory_type), intent(in) :: trajectory
    character(len=:), allocatable :: text
    !> Relative accuracy of the stop in a step, if it is located.
    real(wp), parameter :: located = 1.0e-6_wp
    real(wp), allocatable :: state(:)
    real(wp) :: further
    integer :: i, m, n

    text = ''
    m = size(trajectory%t)
    if (subject%is_pendulum .or. subject%is_turning) return
    if (m == 0) return
    ! With memory a motion leaves a law within a step: the last state is before that.
    state = trajectory%states(:, m)
    further = 2.0_wp*(trajectory%t_reached - trajectory%t(m)) + trajectory%h
    select type (motion => self%motion)
    type is (transient_job)
      state = trajectory%last
      further = located*trajectory%h
    end select
    n = size(self%motion%initial)
    if (subject%is_structure) then
      if (.not. allocated(trajectory%places)) return
      do i = 1, size(subject%model%elements)
        associate (element => subject%model%elements(i), places => trajectory%places)
          ! The arguments of an element must have been kept.
          if (abs(sum(abs(element%direction)) - sum(abs(element%direction(places)))) > 0.0_wp) cycle
          text = law_end_text(element%laws, ['d'], [dot_product(element%direction(places), &
                                                                state(1::2)), &
                                                    dot_product(element%direction(places), &
                                                                state(2::2))], further)
          if (text /= '') return
        end associate
      end do
    else if (allocated(subject%polynomial%laws) .and. size(state) == n) then
      text = law_end_text(subject%polynomial%laws, subject%coordinates, state, further)
    end if
  end function law_end

  !> Coordinates that tables, spectra and events need.
  pure function places(self)
    class(motion_job), intent(in) :: self
    integer, allocatable :: places(:)
    integer :: i
    places = self%wanted
    if (self%spectrum%wanted) places = union(places, self%spectrum%transformed)
    if (self%decay%wanted) places = union(places, self%decay%fitted)
    if (allocated(self%motion%point)) places = union(places, [(i, i=1, 6)])
    if (.not. allocated(self%motion%watched)) return
    associate (n => size(self%motion%initial)/2)
      places = union(places, pack([(i, i=1, n)], coordinates_read(self%motion%watched, n)))
    end associate
  end function places

  !> Union of two lists of coordinates.
  pure function union(places, others)
    integer, intent(in) :: places(:), others(:)
    integer, allocatable :: union(:)
    integer :: i
    union = places
    do i = 1, size(others)
      if (.not. any(union == others(i))) union = [union, others(i)]
    end do
  end function union

  !> A row a time.
  subroutine put_motion(self, subject, trajectory, quantities, method, sink, status)
    class(motion_job), intent(in) :: self
    type(subject_type), intent(in) :: subject
    type(trajectory_type), intent(in), target :: trajectory
    type(motion_quantities), intent(in), target :: quantities
    character(len=*), intent(in) :: method
    class(table_sink), intent(inout) :: sink
    type(status_type), intent(out) :: status
    type(table_type) :: table
    character(len=:), allocatable :: name
    integer :: i, row

    if (counting) call count_up(counted_columns, size(self%wanted))
    call table%note('method '//method//', step '//trim(exact(trajectory%h))//', ' &
                    //trim(run_names(trajectory%outcome))//error_text(trajectory%error))
    call table%note(units_of(self, subject))
    call table%add_reals('t', trajectory%t)
    do i = 1, size(self%wanted)
      name = trim(subject%coordinates(self%wanted(i)))
      row = trajectory%row_of(self%wanted(i))
      call table%add_reals(name, trajectory%states(row, :))
      call table%add_reals(name//'_dot', trajectory%states(row + 1, :))
      if (self%motion%wants_accelerations) then
        call table%add_reals(name//'_ddot', quantities%accelerations(self%wanted(i), :))
      end if
    end do
    if (allocated(quantities%point)) then
      do i = 1, size(of_point)
        call table%add_reals(trim(of_point(i)), quantities%point(:, i))
      end do
    end if
    call sink%put(self%kind, table, status)
  end subroutine put_motion

  !> One row per event, ordered by the event functions.
  subroutine put_events(self, subject, trajectory, sink, status)
    class(motion_job), intent(in) :: self
    type(subject_type), intent(in) :: subject
    type(trajectory_type), intent(in) :: trajectory
    class(table_sink), intent(inout) :: sink
    type(status_type), intent(out) :: status
    type(table_type) :: table
    character(len=:), allocatable :: name
    integer, allocatable :: order(:)
    integer :: i, j, row

    allocate (order(0))
    associate (watch => trajectory%watch)
      do i = 1, size(self%events)
        call table%note('event '//show(i)//': '//self%events(i)%text//', ' &
                        //things(watch%count_of(i), 'occurrence'))
        order = [order, pack([(j, j=1, watch%n_found)], watch%which(:watch%n_found) == i)]
      end do
      call table%note(units_of(self, subject))
      call table%hold_integers('event', watch%which(order))
      call table%hold_reals('t', watch%times(order))
      if (allocated(trajectory%event_point_errors)) then
        call table%hold_reals('t_error', trajectory%event_point_errors(1, order))
        call table%hold_reals('state_error', trajectory%event_point_errors(2, order))
      end if
      do i = 1, size(self%wanted)
        name = trim(subject%coordinates(self%wanted(i)))
        row = trajectory%row_of(self%wanted(i))
        if (watch%n_found == 0) then
          call table%hold_reals(name, [real(wp) ::])
          call table%hold_reals(name//'_dot', [real(wp) ::])
          cycle
        end if
        call table%hold_reals(name, watch%states(row, order))
        call table%hold_reals(name//'_dot', watch%states(row + 1, order))
      end do
    end associate
    call sink%put('event', table, status)
  end subroutine put_events

  !> The line about units of the columns of a motion.
  function units_of(self, subject) result(text)
    class(motion_job), intent(in) :: self
    type(subject_type), intent(in) :: subject
    character(len=:), allocatable :: text
    text = trim(merge('dimensionless: t in 1/omega_1', 'units: t in s                ', &
                      subject%is_pendulum))//', ' &
           //listed_units(subject%coordinates(self%wanted), subject%units(self%wanted))
  end function units_of

  !> One row per frequency, from the last `kept` states.
  subroutine put_spectrum(self, subject, trajectory, kept, shares, sink, status)
    type(spectrum_job), intent(in) :: self
    type(subject_type), intent(in) :: subject
    type(trajectory_type), intent(in) :: trajectory
    integer, intent(in) :: kept
    !> As in `aliased_shares`.
    real(wp), intent(in) :: shares(:)
    class(table_sink), intent(inout) :: sink
    type(status_type), intent(out) :: status
    type(table_type) :: table
    complex(wp), allocatable :: spectrum(:)
    character(len=:), allocatable :: name
    real(wp) :: step
    integer :: i, k, first

    if (counting) call count_up(counted_columns, size(self%transformed))
    first = size(trajectory%t) - kept + 1
    step = trajectory%t(min(2, size(trajectory%t))) - trajectory%t(1)
    allocate (spectrum(0:kept/2))
    call table%note('window '//trim(window_names(self%window))//'; omega in rad per unit of ' &
                    //'time, phases in rad at the first sample')
    do i = 1, size(shares)
      if (is_aliased(shares(i), kept)) call table%note('states are too far apart for ' &
        //trim(subject%coordinates(self%transformed(i)))//': faster components are aliased')
    end do
    call table%hold_reals('omega', [(2.0_wp*pi/(kept*step)*k, k=0, kept/2)])
    do i = 1, size(self%transformed)
      call amplitude_spectrum(trajectory%states(trajectory%row_of(self%transformed(i)), &
                                                    first:), self%window, spectrum)
      name = trim(subject%coordinates(self%transformed(i)))
      call table%hold_reals(name//'_amplitude', modulus(spectrum))
      call table%hold_reals(name//'_phase', argument(spectrum))
    end do
    call sink%put('spectrum', table, status)
  end subroutine put_spectrum

  !> One row per oscillation, the largest first.
  subroutine put_decay(self, subject, trajectory, sink, folded, status)
    type(decay_job), intent(in) :: self
    type(subject_type), intent(in) :: subject
    type(trajectory_type), intent(in) :: trajectory
    class(table_sink), intent(inout) :: sink
    !> Coordinates with components above the Nyquist frequency.
    character(len=:), allocatable, intent(out) :: folded
    type(status_type), intent(out) :: status
    type(table_type) :: table
    type(decay_type), target :: decay
    type(spectrum_job) :: fitted
    real(wp), allocatable :: q(:, :)
    integer :: first, i, n

    folded = ''
    n = count(trajectory%t >= self%start*(1.0_wp - 1.0e-12_wp))
    first = size(trajectory%t) - n + 1
    allocate (q(n, size(self%fitted)))
    do i = 1, size(self%fitted)
      q(:, i) = trajectory%states(trajectory%row_of(self%fitted(i)), first:)
    end do
    call find_free_decay(trajectory%t(first:), q, self%count, decay, status)
    if (status%failed()) return
    fitted%transformed = self%fitted
    folded = aliases(fitted, subject, trajectory, n, aliased_shares(fitted, trajectory, n))
    call table%note('motions Re(a exp(s t)), the largest first; largest residual of a ' &
                    //'coordinate '//trim(exact(decay%residual))//' of its largest value')
    call table%add_complex('s', decay%roots)
    do i = 1, size(self%fitted)
      call table%add_complex(trim(subject%coordinates(self%fitted(i))), decay%amplitudes(:, i))
    end do
    call sink%put('free_decay', table, status)
  end subroutine put_decay

  ! The position at which a motion stops because a force law has no value beyond it.

  !> "; the law 'log(1 + x)' has no value beyond x = -1", or empty if all laws have values.
  function law_end_text(laws, names, state, reach) result(text)
    type(law_term), intent(in) :: laws(:)
    !> Names of the coordinates.
    character(len=*), intent(in) :: names(:)
    !> At the stop, (q_1, v_1, q_2, ...); largest further time of the motion (s).
    real(wp), intent(in) :: state(:), reach
    character(len=:), allocatable :: text
    real(wp) :: part(n_places), middle
    logical :: outside(n_places)
    integer :: b, i, j, k

    text = ''
    do i = 1, size(laws)
      if (laws(i)%state > 0) cycle
      ! From the state itself in equal parts, then bisection of one of them.
      part = [(reach*real(k - 1, wp)/real(n_places - 1, wp), k=1, n_places)]
      outside = beyond(laws(i), state, part)
      if (.not. any(outside)) cycle
      k = findloc(outside, .true., 1)
      if (k > 1) then
        do j = 1, halvings
          middle = 0.5_wp*(part(k - 1) + part(k))
          outside = beyond(laws(i), state, spread(middle, 1, n_places))
          part(merge(k, k - 1, outside(1))) = middle
        end do
      end if
      do b = 1, size(names)
        if (.not. any(abs(laws(i)%arguments(:, b)) > 0.0_wp)) cycle
        if (len(text) > 0) text = text//','
        text = text//' '//trim(names(b))//' = ' &
               //show(six_digits(state(2*b - 1) + part(k)*state(2*b)))
      end do
      if (allocated(laws(i)%text)) then
        text = "; the law '"//laws(i)%text//"' has no value beyond"//text
      else
        text = '; a force law has no value beyond'//text
      end if
      return
    end do
  end function law_end_text

  !> True at times on the way at which a law has no value.
  pure function beyond(law, state, part)
    type(law_term), intent(in) :: law
    real(wp), intent(in) :: state(:), part(:)
    logical :: beyond(size(part))
    real(wp) :: q(size(part), size(state)/2), value(size(part))
    integer :: k
    do k = 1, size(part)
      q(k, :) = state(1::2) + part(k)*state(2::2)
    end do
    call law%program%evaluate(matmul(q, transpose(law%arguments)) &
                              + spread(matmul(law%rates, state(2::2)), 1, size(part)), value)
    ! A missing value is represented by exactly `wall`.
    beyond = abs(value - wall) <= 0.0_wp
  end function beyond

end module viscovib_motion_job
