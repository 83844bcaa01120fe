!> The &load groups of a scene.
module viscovib_load_groups
  use viscovib_constants, only: pi
  use viscovib_frequency_law, only: frequency_law, new_frequency_law
  use viscovib_group_reader, only: group_reader
  use viscovib_growing_text, only: growing_text
  use viscovib_kinds, only: wp
  use viscovib_law_faults, only: complain_of_law
  use viscovib_load, only: load_type, new_load
  use viscovib_namelist, only: lower, namelist_type
  use viscovib_scene_groups, only: place_of
  use viscovib_status, only: clipped, set_ok, show, status_type
  use viscovib_subject, only: subject_type
  use viscovib_timed_groups, only: read_in_time
  implicit none
  private

  public :: read_frequency, read_loads

  !> Kinds: 1 is a force.
  integer, parameter :: moves = 2, unbalances = 3, accelerates = 4
  !> Results under loads that repeat.
  character(len=*), parameter :: repeating(8) = &
    [character(len=15) :: 'response', 'branch', 'multiple_scales', 'equilibrium', &
     'steady_motion', 'trace_motion', 'ensemble', 'basins']

  !> Terms of a load, as for `new_load`; those of the first n are set.
  type :: term_list
    integer :: n = 0
    integer, allocatable :: orders(:), law_of(:)
    complex(wp), allocatable :: force(:, :), base(:), moved(:, :)
    type(frequency_law), allocatable :: laws(:)
    !> Shocks and records, for a motion in time.
    type(load_type) :: in_time
    !> Whether the scene wants motions that these do not move.
    logical :: repeats = .false.
    !> Accelerations along the direction of the system, and of coordinates, that were read.
    logical :: along(2) = .false.
  contains
    procedure :: add
  end type term_list

contains

  !> Every &load is a term amplitude sin(order nu t + phase), times (order nu)^2 for an unbalance.
  !! Amplitude and phase may depend on nu. Others are shocks and records. They are added.
  subroutine read_loads(file, subject, load, echo, status)
    type(namelist_type), intent(in) :: file
    !> What it acts on. Its warnings are those of records, too.
    type(subject_type), intent(inout) :: subject
    type(load_type), intent(out) :: load
    !> Gets the canonical text of the groups added.
    type(growing_text), intent(inout) :: echo
    type(status_type), intent(out) :: status
    type(group_reader) :: reader
    type(term_list) :: terms
    integer :: i, n

    ! A load whose phase depends on nu has two terms, a motion of a base with supports has four.
    n = 4*count([(file%groups(i)%name == 'load', i=1, size(file%groups))])
    allocate (terms%orders(n), terms%law_of(n), source=0)
    allocate (terms%laws(n))
    allocate (terms%base(n), terms%force(size(subject%coordinates), n), source=(0.0_wp, 0.0_wp))
    terms%moved = terms%force
    terms%repeats = any([(place_of(file, trim(repeating(i))) <= size(file%groups), &
                          i=1, size(repeating))])
    call set_ok(status)
    do i = 1, size(file%groups)
      if (file%groups(i)%name /= 'load') cycle
      call reader%start(file%path, file%groups(i))
      call read_load(reader, subject, terms)
      call reader%close(echo, status)
      if (status%failed()) return
    end do
    n = terms%n
    call new_load(load, size(subject%coordinates), terms%orders(:n), terms%force(:, :n), &
                  terms%base(:n), status, terms%moved(:, :n), terms%laws, terms%law_of(:n))
    if (.not. terms%in_time%has_table()) return
    load%table = terms%in_time%table
    load%pushes = terms%in_time%pushes
    load%floors = terms%in_time%floors
  end subroutine read_loads

  subroutine read_load(reader, subject, terms)
    type(group_reader), intent(inout) :: reader
    type(subject_type), intent(inout) :: subject
    type(term_list), intent(inout) :: terms
    character(len=:), allocatable :: kind_name, word, by, turn
    real(wp), allocatable :: shape(:)
    real(wp) :: amplitude, phase
    integer :: kind, on, order, support

    on = 1
    support = 0
    kind_name = reader%read_text('kind', choice=kind)
    allocate (shape(size(subject%coordinates)), source=0.0_wp)
    if (kind == moves .or. kind == accelerates) then
      call read_base(reader, subject, kind == accelerates, on, support)
      shape(on) = 1.0_wp
      if (kind == accelerates) then
        if (.not. reader%has('on')) shape = subject%base_direction()
        call check_mixed(reader, terms%along)
      end if
    else if (reader%has('force') .or. reader%has('torque')) then
      deallocate (shape)
      call read_direction(reader, subject, shape)
    else
      call reader%refuse(['at'], 'needs force')
      word = reader%read_text('on', trim(subject%coordinates(1)), subject%coordinates, on)
      shape(on) = 1.0_wp
    end if
    if (reader%may_have('shape') .or. kind == accelerates) then
      call read_in_time(reader, subject, kind_name, terms%repeats, shape, terms%in_time)
      return
    end if
    order = reader%read_integer('order')
    if (reader%has('force') .or. reader%has('torque')) then
      call reader%read_formula('amplitude', amplitude, by, 1.0_wp)
    else
      call reader%read_formula('amplitude', amplitude, by)
    end if
    turn = ''
    phase = 0.5_wp*pi
    if (order == 0) then
      call reader%refuse(['phase'], 'the mean (order 0) has none')
    else
      call reader%read_formula('phase', phase, turn)
    end if
    call check_formula(reader, 'amplitude', by, kind == moves, order)
    call check_formula(reader, 'phase', turn, kind == moves, order)
    if (kind == unbalances .and. order == 0) then
      call reader%complain('order', "order = 0: kind = 'unbalance' turns, must be 1, 2, ...")
    end if
    if (reader%status%failed()) return
    if (kind == moves .and. support > 0) then
      associate (supports => subject%model%supports)
        call add_supports(terms, order, amplitude*unit_at(order, phase), &
                          supports%places(:, support), supports%rates(:, support), &
                          supports%masses(:, support))
      end associate
      call subject%model%supports%move_apart(support, order, amplitude*unit_at(order, phase))
      return
    end if
    if (kind == moves) then
      if (allocated(subject%model%supports%mass)) then
        associate (supports => subject%model%supports)
          call add_supports(terms, order, amplitude*unit_at(order, phase), supports%place, &
                            supports%rate, supports%mass)
          supports%pull = supports%pull .or. supports%are_pulled()
        end associate
      end if
      call terms%add(order, 0.0_wp*shape, (1.0_wp, 0.0_wp), '')
      associate (n => terms%n, term => amplitude*unit_at(order, phase))
        if ((subject%is_polynomial .or. subject%is_turning) .and. reader%has('on')) then
          terms%moved(:, n) = shape*term
        else
          terms%base(n) = term
        end if
      end associate
      return
    end if
    by = in_brackets(by)
    if (kind == unbalances) then
      amplitude = amplitude*order**2
      by = product_of(by, 'nu^2')
    end if
    if (turn == '') then
      call terms%add(order, shape, amplitude*unit_at(order, phase), by)
    else
      ! amplitude exp(i phase)
      turn = in_brackets(turn)
      call terms%add(order, shape, cmplx(amplitude, 0.0_wp, wp), product_of(by, 'cos'//turn))
      call terms%add(order, shape, cmplx(0.0_wp, amplitude, wp), product_of(by, 'sin'//turn))
    end if
  end subroutine read_load

  !> Add the forces -K u - C u' - M u'' of a motion u of supports.
  subroutine add_supports(terms, order, moved, stiffness, damping, mass)
    type(term_list), intent(inout) :: terms
    integer, intent(in) :: order
    !> u.
    complex(wp), intent(in) :: moved
    !> Columns of K, C and M.
    real(wp), intent(in) :: stiffness(:), damping(:), mass(:)

    call terms%add(order, stiffness, -moved, '')
    if (order == 0) return
    if (any(abs(damping) > 0.0_wp)) call terms%add(order, damping, &
                                                   cmplx(0.0_wp, -order, wp)*moved, 'nu')
    if (any(abs(mass) > 0.0_wp)) call terms%add(order, mass, order**2*moved, 'nu^2')
  end subroutine add_supports

  !> exp(i phase); i for the mean.
  pure complex(wp) function unit_at(order, phase)
    integer, intent(in) :: order
    real(wp), intent(in) :: phase
    unit_at = cmplx(cos(phase), sin(phase), wp)
    if (order == 0) unit_at = (0.0_wp, 1.0_wp)
  end function unit_at

  pure function in_brackets(text) result(whole)
    character(len=*), intent(in) :: text
    character(len=:), allocatable :: whole
    whole = ''
    if (text /= '') whole = '('//text//')'
  end function in_brackets

  pure function product_of(first, second) result(text)
    character(len=*), intent(in) :: first, second
    character(len=:), allocatable :: text
    text = second
    if (first /= '') text = first//'*'//second
  end function product_of

  !> Refuse a formula that cannot be compiled, or where the load must be constant.
  subroutine check_formula(reader, key, text, is_base, order)
    type(group_reader), intent(inout) :: reader
    character(len=*), intent(in) :: key, text
    logical, intent(in) :: is_base
    integer, intent(in) :: order
    type(frequency_law) :: law
    character(len=:), allocatable :: fault

    if (text == '' .or. reader%status%failed()) return
    call new_frequency_law(law, lower(text), fault)
    if (fault /= '') then
      call complain_of_law(reader, key, text, fault, ['nu'], 'must be a number or a formula in nu')
    else if (is_base) then
      call reader%complain(key, key//" = '"//clipped(text)//"': must be a number for kind = 'base'")
    else if (order == 0) then
      call reader%complain(key, key//" = '"//clipped(text)//"': must be a number for order = 0, " &
                           //'the mean does not depend on nu')
    end if
  end subroutine check_formula

  !> Add a force, multiplied by a formula in nu if there is one.
  subroutine add(self, order, shape, factor, formula)
    class(term_list), intent(inout) :: self
    integer, intent(in) :: order
    real(wp), intent(in) :: shape(:)
    complex(wp), intent(in) :: factor
    character(len=*), intent(in) :: formula
    character(len=:), allocatable :: fault

    self%n = self%n + 1
    self%orders(self%n) = order
    self%force(:, self%n) = factor*shape
    if (formula == '') return
    self%law_of(self%n) = self%n
    call new_frequency_law(self%laws(self%n), lower(formula), fault)
  end subroutine add

  !> Accelerations of a base are all along its direction, or all of coordinates.
  subroutine check_mixed(reader, along)
    type(group_reader), intent(inout) :: reader
    !> Accelerations along the direction of the system, and of coordinates, that were read.
    logical, intent(inout) :: along(2)
    along(merge(2, 1, reader%has('on'))) = .true.
    if (all(along)) then
      call reader%complain('kind', "kind = 'acceleration': another one is along base_direction: " &
                           //"all of them must have on, or none")
    end if
  end subroutine check_mixed

  !> A base that moves along the direction of its system, or one coordinate of it, or a support.
  subroutine read_base(reader, subject, accelerated, on, support)
    type(group_reader), intent(inout) :: reader
    type(subject_type), intent(in) :: subject
    !> Whether its acceleration is given.
    logical, intent(in) :: accelerated
    !> The coordinate; the support, 0: none.
    integer, intent(out) :: on, support
    character(len=:), allocatable :: word
    integer :: n

    on = 1
    support = 0
    call reader%refuse(['force ', 'torque', 'at    '], 'only a force has this key')
    if (.not. reader%has('on')) then
      if (.not. any(abs(subject%base_direction()) > 0.0_wp)) then
        call reader%complain('kind', "kind = '"//trim(merge('acceleration', 'base        ', &
                             accelerated))//"': needs base_direction in &system, or on = the " &
                             //'coordinate that moves')
      end if
      return
    end if
    if (allocated(subject%model%supports%names) .and. .not. accelerated) then
      associate (supports => subject%model%supports)
        word = reader%read_text('on', trim(supports%names(1)), supports%names, support)
        if (supports%are_turned) then
          call reader%complain('on', "on = '"//word//"': supports must not move if gyroscopic, " &
                               //'circulatory or centrifugal act on them')
        else if (supports%bent_by(support) > 0) then
          call reader%complain('on', "on = '"//word//"': &element "//show(supports%bent_by( &
                               support))//' or a layer with memory acts on this support: must be ' &
                               //'a linear spring or damper; give all supports one motion by ' &
                               //'base_direction')
        end if
      end associate
      return
    end if
    if (.not. (subject%is_polynomial .or. subject%is_turning) .or. allocated(subject%model%mass) &
        .or. size(subject%coordinates) == 1) then
      call reader%complain('on', 'on: the base moves as a whole; only a force has this key here')
      return
    end if
    n = size(subject%coordinates)
    if (subject%is_body) n = 6
    word = reader%read_text('on', trim(subject%coordinates(1)), subject%coordinates(:n), on)
    if (accelerated .and. on > 3 .and. subject%is_body .and. .not. subject%is_turning) then
      if (any(abs([subject%body%gravity, subject%body%spin]) > 0.0_wp)) then
        call reader%complain('on', "on = '"//word//"': the weight or the spin does not turn with " &
                             //"the base, must be kind = 'base'")
      end if
    end if
    if (on > 3 .and. any(abs(subject%body%rotor) > 0.0_wp)) then
      call reader%complain('on', "on = '"//word//"': must not turn the floor with a rotor at the " &
                           //'speed of the load: give speed in &body')
    end if
    if (.not. subject%is_turning) return
    if (on > 3) then
      call reader%complain('on', "on = '"//word//"': must not turn the floor with geometry = " &
                           //"'exact', give x, y or z")
    else if (subject%turning%loads_turn) then
      call reader%complain('on', "load_axes = 'body': must be 'space' where the floor moves with " &
                           //"geometry = 'exact'")
    end if
  end subroutine read_base

  !> A force in any direction at a point of a body, and a torque, on its coordinates.
  subroutine read_direction(reader, subject, shape)
    type(group_reader), intent(inout) :: reader
    type(subject_type), intent(in) :: subject
    real(wp), allocatable, intent(out) :: shape(:)
    real(wp) :: force(3), torque(3), arm(3)

    allocate (shape(size(subject%coordinates)), source=0.0_wp)
    call reader%refuse(['on'], 'force and torque say where it acts')
    if (.not. subject%is_body) then
      call reader%refuse(['force ', 'torque'], 'is of a &body, must be left out')
      return
    end if
    force = reader%read_reals('force')
    torque = reader%read_reals('torque')
    arm = reader%read_reals('at', 3, subject%center) - subject%center
    if (reader%status%failed()) return
    if (subject%is_turning) then
      if (.not. subject%turning%loads_turn .and. any(abs(arm) > 0.0_wp)) then
        call reader%complain('at', "at: with geometry = 'exact' and load_axes = 'space' the arm " &
                             //'of a force turns with the body: must be the centre of mass')
      end if
    end if
    arm = matmul(subject%axes, arm)
    shape(:3) = force
    shape(4:6) = torque + [arm(2)*force(3) - arm(3)*force(2), arm(3)*force(1) - arm(1)*force(3), &
                           arm(1)*force(2) - arm(2)*force(1)]
  end subroutine read_direction

  !> The frequency nu of a load that has one.
  subroutine read_frequency(reader, load, nu)
    type(group_reader), intent(inout) :: reader
    type(load_type), intent(in) :: load
    real(wp), intent(out) :: nu
    type(status_type) :: status

    nu = 0.0_wp
    if (any(load%orders > 0)) then
      nu = reader%read_real('nu')
      if (reader%status%failed()) return
      call load%check_at([nu], status)
      if (status%failed()) call reader%complain('nu', status%message)
    else
      call reader%refuse(['nu'], 'is the frequency of a load, and none has one')
    end if
  end subroutine read_frequency

end module viscovib_load_groups
