!> Laws of scenes that are no polynomials, and errors in their text. Messages show the text of the
!! file, with names of parameters instead of their numbers.
module viscovib_law_faults
  use viscovib_group_reader, only: group_reader
  use viscovib_kinds, only: wp
  use viscovib_law_program, only: law_program
  use viscovib_law_term, only: about_rest, law_term
  use viscovib_law_text, only: compile_law
  use viscovib_namelist, only: lower
  use viscovib_polynomial_text, only: expand, terms_type
  use viscovib_status, only: clipped
  implicit none
  private

  public :: complain_of_law, compile_term, read_law

contains

  !> Refuse a law. The message for an unknown name contains the nearest parameter.
  subroutine complain_of_law(reader, key, text, fault, arguments, must)
    type(group_reader), intent(inout) :: reader
    !> Its key, and what was read: numbers stand for names.
    character(len=*), intent(in) :: key, text, fault
    !> What it may depend on; without: the fault is no matter of names.
    character(len=*), intent(in), optional :: arguments(:)
    !> What it must be, before the fault.
    character(len=*), intent(in), optional :: must
    character(len=:), allocatable :: written, description, other
    type(law_program) :: program
    integer :: parity, degree

    written = reader%group%written(key, text)
    description = fault
    if (present(arguments) .and. allocated(reader%group%names)) then
      call compile_law(lower(written), arguments, reader%group%names, reader%group%values, &
                       program, parity, degree, other)
      if (other /= '') description = other
    end if
    if (present(must)) description = must//': '//description
    call reader%complain(key, key//" = '"//clipped(written)//"': "//description)
  end subroutine complain_of_law

  !> The law of a key: monomials of the coordinates, or any function of coordinates and rates. Its
  !! derivatives at equilibrium are 0 if it has monomials.
  subroutine read_law(reader, text, arguments, kernel, effort, terms, law, slopes)
    type(group_reader), intent(inout) :: reader
    character(len=*), intent(in) :: text
    !> Names of n coordinates, then of their rates.
    character(len=*), intent(in) :: arguments(:)
    integer, intent(in) :: kernel
    !> Remaining steps of expansion.
    integer, intent(inout) :: effort
    type(terms_type), intent(out) :: terms
    !> Allocated if the law has no monomials.
    type(law_term), allocatable, intent(out) :: law
    !> Shape (2 n).
    real(wp), intent(out) :: slopes(:)
    character(len=:), allocatable :: fault

    slopes = 0.0_wp
    call expand(lower(text), arguments(:size(arguments)/2), terms, fault, effort)
    ! What is not 0 at rest, a static force, is taken as other laws are.
    if (fault == '' .and. .not. any(sum(terms%powers, 1) == 0)) return
    allocate (law)
    call compile_term(law, text, arguments, kernel, slopes, fault)
    if (fault /= '') call complain_of_law(reader, 'law', text, fault, arguments)
  end subroutine read_law

  !> A law that is no polynomial, of coordinates and their rates. If its text cannot be compiled,
  !! the fault stays, or becomes a clearer one.
  subroutine compile_term(law, text, arguments, kernel, slopes, fault)
    type(law_term), intent(out) :: law
    character(len=*), intent(in) :: text
    !> Names of n coordinates, then of their rates.
    character(len=*), intent(in) :: arguments(:)
    integer, intent(in) :: kernel
    !> Derivatives at equilibrium, shape (2 n).
    real(wp), intent(out) :: slopes(:)
    !> Fault of the text as a polynomial; empty: the law is valid.
    character(len=:), allocatable, intent(inout) :: fault
    character(len=len(arguments)) :: none(0)
    character(len=:), allocatable :: other
    real(wp) :: no_values(0)
    integer :: i, n

    n = size(arguments)/2
    slopes = 0.0_wp
    call compile_law(lower(text), arguments, none, no_values, law%program, law%parity, law%degree, &
                     other)
    if (other /= '') then
      if (scan(text, '(<>') > 0 .or. index(lower(text), '_dot') > 0 &
          .or. any([(index(lower(text), trim(arguments(i))) > 0, i=n + 1, 2*n)])) fault = other
      return
    end if
    law%kernel = kernel
    law%text = text
    call about_rest(law, slopes, fault)
    if (fault /= '') return
    allocate (law%arguments(2*n, n), law%rates(2*n, n), source=0.0_wp)
    do i = 1, n
      law%arguments(i, i) = 1.0_wp
      law%rates(n + i, i) = 1.0_wp
    end do
    call law%drop_unread()
  end subroutine compile_term

end module viscovib_law_faults
