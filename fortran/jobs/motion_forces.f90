!> Forces of mounts, elements and springs along a motion in time, and reactions at supports.
module viscovib_motion_forces
  use viscovib_element_forces, only: element_forces_type, find_element_forces, &
    find_forces_by_kernel, find_mount_springs
  use viscovib_job, only: table_sink
  use viscovib_kinds, only: wp
  use viscovib_known_motion, only: known_motion, waves_at
  use viscovib_load, only: load_type
  use viscovib_mount_forces, only: find_mount_forces, find_spring_memory, mount_forces_type
  use viscovib_mounted_body, only: springs_at_rest
  use viscovib_oscillator, only: oscillator_type
  use viscovib_spline_integral, only: spline_integral
  use viscovib_status, only: show, status_type
  use viscovib_subject, only: subject_type
  use viscovib_table, only: table_type
  use viscovib_turning_body, only: body_spring
  implicit none
  private

  public :: motion_forces

  !> Longest name of a quantity.
  integer, parameter, public :: quantity_length = 32
  character(len=3), parameter :: axes = 'xyz'

  type :: motion_forces
    !> The first columns have names.
    class(element_forces_type), allocatable :: parts
    character(len=quantity_length), allocatable :: names(:)
    !> At the supports of a structure, shape (n, n_supports); not allocated: none.
    real(wp), allocatable :: reactions(:, :)
  contains
    procedure :: find
    procedure :: find_reactions
    procedure :: quantities
    procedure :: put
    procedure, private :: find_on_body
    procedure, private :: find_in_structure
    procedure, private :: find_on_coordinates
    procedure, private :: put_reactions
  end type motion_forces

contains

  !> Forces along a motion, without reactions.
  subroutine find(self, subject, nu, known)
    class(motion_forces), intent(out) :: self
    type(subject_type), intent(in), target :: subject
    !> Frequency of the loads (rad/s).
    real(wp), intent(in) :: nu
    type(known_motion), intent(in) :: known

    if (subject%is_body) then
      call self%find_on_body(subject, known)
    else if (subject%model%n_given >= 0) then
      call self%find_in_structure(subject, nu, known)
    else if (allocated(subject%polynomial%laws)) then
      call self%find_on_coordinates(subject, known)
    else
      self%names = [character(len=quantity_length) :: 'spring_x', 'spring_phi']
      allocate (self%parts)
      call find_mount_springs(subject%mount, known%sampled_motion, self%parts)
    end if
  end subroutine find

  !> Forces of the mounts of a body, along the axes of each.
  subroutine find_on_body(self, subject, known)
    class(motion_forces), intent(inout) :: self
    type(subject_type), intent(in) :: subject
    type(known_motion), intent(in) :: known
    type(body_spring) :: springs(size(subject%body%springs))
    type(mount_forces_type), allocatable :: forces
    real(wp), allocatable :: memory(:, :)
    real(wp) :: center(3)
    integer :: a, i

    center = subject%center
    if (subject%is_turning) center = center + subject%rest%q(:3)
    springs = springs_at_rest(subject%body, subject%rest)
    allocate (memory(size(known%times), size(springs)), source=0.0_wp)
    if (allocated(known%ends)) then
      call find_spring_memory(springs, subject%body_kernels, subject%is_turning, known%ends, &
                              known%panel_u, known%panel_rate, known%held, known%times, memory)
    end if
    allocate (forces)
    call find_mount_forces(springs, subject%body%mount_of, subject%is_turning, center, known%u, &
                           known%rate, memory, forces)
    call move_alloc(forces, self%parts)
    allocate (self%names(3*size(subject%body%names)))
    do i = 1, size(subject%body%names)
      do a = 1, 3
        self%names(3*(i - 1) + a) = trim(subject%body%names(i))//'.'//axes(a:a)
      end do
    end do
  end subroutine find_on_body

  !> Forces of elements; with supports also of layers that act on these.
  subroutine find_in_structure(self, subject, nu, known)
    class(motion_forces), intent(inout) :: self
    type(subject_type), intent(in), target :: subject
    real(wp), intent(in) :: nu
    type(known_motion), intent(in) :: known
    class(oscillator_type), pointer :: system
    integer :: i, n

    n = subject%model%n_given
    allocate (self%names(n), self%parts)
    do i = 1, n
      self%names(i) = 'element'//show(i)
    end do
    do i = n + 1, size(subject%model%elements)
      if (.not. allocated(subject%model%elements(i)%ends)) exit
      if (any(abs(subject%model%elements(i)%ends) > 0.0_wp)) n = i
    end do
    system => subject%oscillator()
    if (.not. allocated(subject%model%supports%names)) then
      call find_element_forces(subject%model%elements(:n), system%kernels, known%sampled_motion, &
                               self%parts)
      return
    end if
    call find_element_forces(subject%model%elements(:n), system%kernels, known%sampled_motion, &
                             self%parts, apart_at(subject, nu, known%times))
  end subroutine find_in_structure

  !> Forces on each coordinate of the springs and laws with each kernel.
  subroutine find_on_coordinates(self, subject, known)
    class(motion_forces), intent(inout) :: self
    type(subject_type), intent(in) :: subject
    type(known_motion), intent(in) :: known
    type(element_forces_type) :: own
    integer :: i, k, n

    n = size(subject%coordinates)
    allocate (self%names(0), self%parts)
    associate (all => self%parts, system => subject%polynomial)
      do k = 0, size(system%kernels)
        if (.not. (any(system%kernel_of == k) .or. (k == 0 .and. &
                                                   any(abs(system%damping) > 0.0_wp)))) cycle
        call find_forces_by_kernel(system, known%sampled_motion, own, k)
        self%names = [self%names, [(name_of(i), i=1, n)]]
        if (.not. allocated(all%elastic)) then
          all%deflection = own%deflection
          all%rate = own%rate
          all%elastic = own%elastic
          all%damping = own%damping
          all%memory = own%memory
          cycle
        end if
        all%deflection = joined(all%deflection, own%deflection)
        all%rate = joined(all%rate, own%rate)
        all%elastic = joined(all%elastic, own%elastic)
        all%damping = joined(all%damping, own%damping)
        all%memory = joined(all%memory, own%memory)
      end do
    end associate

  contains

    character(len=quantity_length) function name_of(i)
      integer, intent(in) :: i
      name_of = 'kernel'//show(k)//'_'//trim(subject%coordinates(i))
    end function name_of

    function joined(left, right) result(both)
      real(wp), intent(in) :: left(:, :), right(:, :)
      real(wp) :: both(size(left, 1), size(left, 2) + size(right, 2))
      both(:, :size(left, 2)) = left
      both(:, size(left, 2) + 1:) = right
    end function joined

  end subroutine find_on_coordinates

  !> Forces that hold or move the supports: M_s u'' + C_s u' + K_s u and those of elements.
  subroutine find_reactions(self, subject, nu, known, accelerations)
    class(motion_forces), intent(inout) :: self
    type(subject_type), intent(in) :: subject
    real(wp), intent(in) :: nu
    type(known_motion), intent(in) :: known
    !> Of the free coordinates, a column for each time; not allocated: no mass is between these and
    !! the supports.
    real(wp), allocatable, intent(in) :: accelerations(:, :)
    real(wp) :: moved(size(known%u, 1), size(known%u, 2), 3), base(size(known%u, 1), 3)
    real(wp), allocatable :: force(:, :)
    integer :: j

    moved(:, :, 1) = known%u
    moved(:, :, 2) = known%rate
    moved(:, :, 3) = 0.0_wp
    if (allocated(accelerations)) then
      moved(:, :, 3) = transpose(accelerations) - known%moved(:, :, 3)
    end if
    call find_base(subject, nu, known%times, base)
    self%reactions = subject%model%supports%rows%reactions(moved, base, &
                                                           apart_at(subject, nu, known%times))
    force = self%parts%force()
    do j = 1, size(force, 2)
      associate (ends => subject%model%elements(j)%ends)
        self%reactions = self%reactions + spread(force(:, j), 2, size(ends)) &
                         *spread(ends, 1, size(force, 1))
      end associate
    end do
  end subroutine find_reactions

  !> Displacement, velocity and acceleration of the base of a structure, shape (n, 3).
  subroutine find_base(subject, nu, t, base)
    type(subject_type), intent(in), target :: subject
    real(wp), intent(in) :: nu, t(:)
    real(wp), intent(out) :: base(:, :)
    type(load_type), pointer :: load
    integer :: i

    load => subject%whole_load()
    base = reshape(waves_at(load%orders*nu, reshape(load%base, [1, size(load%base)]), t), &
                   shape(base))
    if (.not. load%has_table()) return
    do i = 1, size(t)
      associate (moves => any(abs(load%floors) > 0.0_wp, 1), &
                 integrals => load%table%integrals(t(i)))
        base(i, 1) = base(i, 1) + sum(integrals(:, 2), moves)
        base(i, 2) = base(i, 2) + sum(integrals(:, 1), moves)
        base(i, 3) = base(i, 3) + sum(load%table%at(t(i)), moves)
      end associate
    end do
  end subroutine find_base

  !> Displacements, velocities and accelerations of supports that move each on its own, shape
  !! (size(t), n_supports, 3).
  function apart_at(subject, nu, t) result(apart)
    type(subject_type), intent(in) :: subject
    real(wp), intent(in) :: nu, t(:)
    real(wp) :: apart(size(t), size(subject%model%supports%names), 3)
    associate (supports => subject%model%supports)
      apart = waves_at(supports%orders*nu, supports%waves, t)
    end associate
  end function apart_at

  !> Names and values, shape (n, size(names)), of the forces, the force on the floor and the
  !! reactions.
  subroutine quantities(self, subject, names, values)
    class(motion_forces), intent(in) :: self
    type(subject_type), intent(in) :: subject
    character(len=quantity_length), allocatable, intent(out) :: names(:)
    real(wp), allocatable, intent(out) :: values(:, :)
    integer :: i, m, n

    n = size(self%names)
    m = n
    if (subject%is_body) m = n + 3
    if (allocated(self%reactions)) m = n + size(self%reactions, 2)
    allocate (names(m), values(size(self%parts%rate, 1), m))
    names(:n) = self%names
    values(:, :n) = self%parts%elastic(:, :n) + self%parts%damping(:, :n) &
                    + self%parts%memory(:, :n)
    select type (forces => self%parts)
    type is (mount_forces_type)
      names(n + 1:) = ['floor.x', 'floor.y', 'floor.z']
      values(:, n + 1:) = forces%floor(:, :3)
    end select
    do i = n + 1, m
      if (subject%is_body) exit
      names(i) = 'reaction_'//subject%model%supports%names(i - n)
      values(:, i) = self%reactions(:, i - n)
    end do
  end subroutine quantities

  !> A row a time: each force, its parts, deflection, rate and energies.
  subroutine put(self, subject, t, sink, status)
    class(motion_forces), intent(in), target :: self
    type(subject_type), intent(in) :: subject
    real(wp), intent(in), target :: t(:)
    class(table_sink), intent(inout) :: sink
    type(status_type), intent(out) :: status
    type(table_type) :: table
    character(len=:), allocatable :: name
    real(wp), allocatable :: force(:, :)
    integer :: a, j

    call put_notes(subject, table)
    call table%add_reals('t', t)
    force = self%parts%force()
    associate (parts => self%parts)
      do j = 1, size(self%names)
        name = trim(self%names(j))
        call table%hold_reals(name, force(:, j))
        call table%add_reals(name//'_elastic', parts%elastic(:, j))
        call table%add_reals(name//'_damping', parts%damping(:, j))
        call table%add_reals(name//'_memory', parts%memory(:, j))
        call table%add_reals(name//'_deflection', parts%deflection(:, j))
        call table%add_reals(name//'_rate', parts%rate(:, j))
        select type (parts)
        type is (mount_forces_type)
          call table%add_reals(name//'_moment', parts%moment(:, j))
        end select
        call table%hold_reals(name//'_work', spline_integral(t, force(:, j)*parts%rate(:, j)))
        call table%hold_reals(name//'_dissipated', &
                              spline_integral(t, parts%damping(:, j)*parts%rate(:, j)))
      end do
      select type (parts)
      type is (mount_forces_type)
        do a = 1, 3
          call table%add_reals('floor.'//axes(a:a), parts%floor(:, a))
          call table%add_reals('floor.'//axes(a:a)//'_moment', parts%floor(:, a + 3))
        end do
      end select
    end associate
    call sink%put('forces', table, status)
    if (status%failed() .or. .not. allocated(self%reactions)) return
    call self%put_reactions(subject, t, sink, status)
  end subroutine put

  !> What the columns of forces are.
  subroutine put_notes(subject, table)
    type(subject_type), intent(in) :: subject
    type(table_type), intent(inout) :: table
    integer :: i

    if (subject%is_body) then
      call table%note('units: t in s, forces in N, moments in N m, deflections in m, rates in ' &
                      //'m/s, work and dissipated energy in J; without the static part')
      return
    end if
    call table%note('units: t in s, forces in N along displacements and N m along rotations, ' &
                    //'work and dissipated energy in J; deflections relative to the base')
    do i = 1, subject%model%n_given
      associate (element => subject%model%elements(i))
        if (allocated(element%across)) then
          call table%note('element'//show(i)//': '//direction_text(element%across))
        else
          call table%note('element'//show(i)//': '//direction_text(element%direction))
        end if
      end associate
    end do
    if (subject%model%n_given < 0 .and. allocated(subject%polynomial%laws)) then
      call table%note('kernel0: springs, laws and the damping matrix without memory; kernel1: ' &
                      //'springs and laws with the first kernel, and so on')
    end if

  contains

    !> A direction as a sum of coordinates.
    function direction_text(e) result(text)
      real(wp), intent(in) :: e(:)
      character(len=:), allocatable :: text
      integer :: i, n
      text = ''
      n = 0
      do i = 1, size(e)
        if (.not. abs(e(i)) > 0.0_wp) cycle
        n = n + 1
        if (n > 4) exit
        if (n > 1) text = text//' '//merge('-', '+', e(i) < 0.0_wp)//' '
        if (n == 1 .and. e(i) < 0.0_wp) text = '-'
        if (abs(abs(e(i)) - 1.0_wp) > 0.0_wp) text = text//show(abs(e(i)))//'*'
        text = text//trim(subject%coordinates(i))
      end do
      if (n > 4) text = text//' + ...'
    end function direction_text

  end subroutine put_notes

  !> A row a time: the force on the structure at each support.
  subroutine put_reactions(self, subject, t, sink, status)
    class(motion_forces), intent(in), target :: self
    type(subject_type), intent(in) :: subject
    real(wp), intent(in), target :: t(:)
    class(table_sink), intent(inout) :: sink
    type(status_type), intent(out) :: status
    type(table_type) :: table
    integer :: j

    call table%note('units: t in s, forces on the structure in N along displacements and N m ' &
                    //'along rotations')
    call table%add_reals('t', t)
    do j = 1, size(self%reactions, 2)
      call table%add_reals('reaction_'//trim(subject%model%supports%names(j)), &
                           self%reactions(:, j))
    end do
    call sink%put('reactions', table, status)
  end subroutine put_reactions

end module viscovib_motion_forces
